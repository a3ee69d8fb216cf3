"""How the package is laid out: what is imported from where, what is public, where attributes are set."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import LONG

ROOT = Path(__file__).parents[1]
SOURCES = {
    path: ast.parse(path.read_text("utf-8"))
    for folder in ("rf_exp", "docs", "examples", "plugins")  # benchmarks and tests may look inside
    for path in sorted((ROOT / folder).rglob("*.py"))
}
PACKAGES = {path.parent: tree for path, tree in SOURCES.items() if path.name == "__init__.py"}
STUBS = {  # of packages whose names are imported once they are asked for
    path.parent: ast.parse(path.read_text("utf-8")) for path in (ROOT / "rf_exp").rglob("__init__.pyi")
}
HOUSE = [path for path in SOURCES if path.is_relative_to(ROOT / "rf_exp")]
CLASSES = [node for path in HOUSE for node in ast.walk(SOURCES[path]) if isinstance(node, ast.ClassDef)]
MOST_MODULES = 14  # of a folder, its stub among them
# Those of which another edits nothing: a task, an asset or a constraint more makes no folder too full.
ADDED_TO = ("conf/task", "rf_exp/tasks/assets", "rf_exp/constraints/checks")
KINDS = {path.stem for each in ADDED_TO for path in (ROOT / each).iterdir()} - {"__init__", "__main__"}
BIRTHPLACES = {"__init__", "__post_init__", "__new__"}


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def listed(package: Path) -> list[tuple[str, ast.alias]]:
    """(inner module, name) of what a stub lists; the module is empty for a module itself."""
    nodes = [node for node in STUBS[package].body if isinstance(node, ast.ImportFrom) and node.level == 1]
    assert len(nodes) == len(STUBS[package].body), f"{named(package)}: a stub holds imports of inner modules"
    return [(node.module or "", each) for node in nodes for each in node.names]


def defined(tree: ast.Module) -> set[str]:
    """The names that a module defines or imports."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            names |= {each.asname or each.name for each in node.names}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
    return names


def public_names(package: Path) -> set[str]:
    """What a package gives to others: what its stub lists, or its `__all__`; empty where it gives nothing."""
    if package in STUBS:
        return {each.asname or each.name for _, each in listed(package)}
    for node in PACKAGES[package].body:
        if isinstance(node, ast.Assign) and [ast.unparse(each) for each in node.targets] == ["__all__"]:
            return set(ast.literal_eval(node.value))
    return set()


def imported(tree: ast.AST) -> Iterator[str]:
    """The full names of what a module imports of `rf_exp`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found = [f"{node.module}.{each.name}" for each in node.names]
        else:
            found = [each.name for each in node.names] if isinstance(node, ast.Import) else []
        yield from (name for name in found if name.startswith("rf_exp."))


def is_public(name: str, importer: Path) -> bool:
    """Whether each package on the way to a name gives the next part of it to who is outside.

    A package within another is one itself if it says what it gives, otherwise merely a folder.
    """
    here = ROOT / "rf_exp"
    for part in name.split(".")[1:]:
        is_room = here in PACKAGES and (here.parent == ROOT / "rf_exp" or public_names(here))
        if is_room and not importer.is_relative_to(here) and part not in public_names(here):
            return False
        here = here / part
    return True


def test_outside_of_a_package_only_its_public_names_are_imported() -> None:
    wrong = [
        f"{named(path)}: {name}"
        for path, tree in SOURCES.items()
        for name in imported(tree)
        if not is_public(name, path)
    ]
    assert not wrong, "\n".join(wrong)


def test_tests_and_benchmarks_look_inside_only_for_what_is_inside() -> None:
    """What a package gives to all is imported from the package, so that it may move within it."""
    paths = [path for folder in ("tests", "benchmarks") for path in sorted((ROOT / folder).rglob("*.py"))]
    wrong = []
    for path in paths:
        for name in imported(ast.parse(path.read_text("utf-8"))):
            package, given = ROOT / "rf_exp" / name.split(".")[1], name.split(".")[-1]
            if not is_public(name, path) and given in public_names(package):
                wrong.append(f"{named(path)}: {name} is given by {named(package)}; import it from there")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("package", [each for each in PACKAGES if public_names(each)], ids=named)
def test_a_package_gives_what_it_says(package: Path) -> None:
    """And what it imports once it is asked for is written once, where the type checker reads it too."""
    if package not in STUBS:
        assert public_names(package) <= defined(PACKAGES[package])
        return
    for module, each in listed(package):
        inner = package / (module or each.name).replace(".", "/")
        is_package = inner / "__init__.py" in SOURCES  # a folder of old bytecode is none
        tree = SOURCES[inner / "__init__.py" if is_package else inner.with_suffix(".py")]
        assert each.asname == each.name, f"{named(package)}: import {each.name} as {each.name}, or it is kept"
        assert not module or each.name in (public_names(inner) if is_package else defined(tree))
    assert not [
        name for name, times in Counter(each.name for _, each in listed(package)).items() if times > 1
    ]
    assert defined(PACKAGES[package]) == {"__getattr__", "__dir__", "__all__"}


def test_no_folder_holds_more_modules_than_are_seen_at_a_glance() -> None:
    """Several modules of one concept have a folder of their own, which is named after it."""
    modules = [*HOUSE, *(package / "__init__.pyi" for package in STUBS)]
    held = Counter(path.parent for path in modules if path.stem not in KINDS)
    full = [f"{named(folder)}: {number}" for folder, number in held.items() if number > MOST_MODULES]
    assert not full, f"at most {MOST_MODULES} modules a folder: {', '.join(full)}"


def assigned(method: ast.FunctionDef) -> set[str]:
    """The attributes of itself to which a method gives a value."""
    if not method.args.args or any(ast.unparse(each) == "staticmethod" for each in method.decorator_list):
        return set()
    promised = {
        each.target for each in ast.walk(method) if isinstance(each, ast.AnnAssign) and not each.value
    }
    return {
        each.attr
        for each in ast.walk(method)
        if isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store) and each not in promised
        if ast.unparse(each.value) == method.args.args[0].arg
    }


def born(cls: ast.ClassDef) -> set[str]:
    """The attributes that every object of a class has from the start, also by those that it descends from."""
    fields = any("dataclass" in ast.unparse(each) for each in cls.decorator_list)
    names: set[str] = set()
    for node in cls.body:
        if isinstance(node, ast.AnnAssign) and (fields or node.value):
            names.add(ast.unparse(node.target))
        elif isinstance(node, ast.Assign):
            names |= {ast.unparse(each) for each in node.targets}
        elif isinstance(node, ast.FunctionDef):
            names |= assigned(node) if node.name in BIRTHPLACES else {node.name}  # a property, with a setter
    bases = {ast.unparse(base).split("[")[0].rsplit(".")[-1] for base in cls.bases}
    for parent in CLASSES:
        names |= born(parent) if parent.name in bases - {cls.name} else set()
    return names


def test_no_attribute_is_born_outside_of_init() -> None:
    """What an object is made of is read in one place, and nothing is missing before a method was called.

    What a method makes anew, such as the state of an episode, is an object of its own, in one attribute.
    """
    late = [
        f"{cls.name}.{method.name} is the first to set self.{name} (line {method.lineno}); set it in __init__"
        for cls in CLASSES
        for method in cls.body
        if isinstance(method, ast.FunctionDef) and method.name not in BIRTHPLACES
        for name in sorted(assigned(method) - born(cls))
    ]
    assert not late, "\n".join(late)


def test_the_longest_modules_of_tests_exist() -> None:
    assert {*LONG} <= {path.stem for path in (ROOT / "tests").rglob("test_*.py")}


def test_no_file_of_tests_is_called_as_another() -> None:
    """The name alone says what failed."""
    called = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert not [name for name, times in called.items() if times > 1]
