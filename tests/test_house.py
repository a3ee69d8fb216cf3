"""How the house is laid out: what is imported from where, what a room gives, where attributes are born."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = {
    path: ast.parse(path.read_text("utf-8"))
    for folder in ("rf_exp", "docs", "examples")  # benchmarks and tests may look inside
    for path in sorted((ROOT / folder).rglob("*.py"))
}
PACKAGES = {path.parent: tree for path, tree in SOURCES.items() if path.name == "__init__.py"}
HOUSE = [path for path in SOURCES if path.is_relative_to(ROOT / "rf_exp")]
CLASSES = [node for path in HOUSE for node in ast.walk(SOURCES[path]) if isinstance(node, ast.ClassDef)]
BIRTHPLACES = {"__init__", "__post_init__", "__new__"}


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def public_names(package: Path) -> set[str]:
    """`__all__` of a package; empty where it gives nothing to others."""
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
    """Whether each room on the way to a name gives the next part of it to who is outside.

    A package within a room is one itself if it says what it gives, otherwise merely a folder.
    """
    here = ROOT / "rf_exp"
    for part in name.split(".")[1:]:
        is_room = here in PACKAGES and (here.parent == ROOT / "rf_exp" or public_names(here))
        if is_room and not importer.is_relative_to(here) and part not in public_names(here):
            return False
        here = here / part
    return True


def test_outside_of_a_room_only_its_public_names_are_imported() -> None:
    wrong = [
        f"{named(path)}: {name}"
        for path, tree in SOURCES.items()
        for name in imported(tree)
        if not is_public(name, path)
    ]
    assert not wrong, "\n".join(wrong)


def test_tests_and_benchmarks_look_inside_only_for_what_is_inside() -> None:
    """What a room gives to all is imported from the room, so that it may move within it."""
    paths = [path for folder in ("tests", "benchmarks") for path in sorted((ROOT / folder).rglob("*.py"))]
    wrong = []
    for path in paths:
        for name in imported(ast.parse(path.read_text("utf-8"))):
            room, given = ROOT / "rf_exp" / name.split(".")[1], name.split(".")[-1]
            if not is_public(name, path) and given in public_names(room):
                wrong.append(f"{named(path)}: {name} is given by {named(room)}; import it from there")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("package", [each for each in PACKAGES if public_names(each)], ids=named)
def test_a_package_gives_what_it_says(package: Path) -> None:
    """And what it imports once it is asked for is, for the type checker, what it imports at once."""
    given, late, checked = set(), [], []
    for node in ast.walk(PACKAGES[package]):
        if isinstance(node, ast.ImportFrom) and not (node.module or "").startswith("typing"):
            given |= {each.asname or each.name for each in node.names}
        elif isinstance(node, ast.FunctionDef | ast.Assign | ast.AnnAssign):
            target = node.targets[0] if isinstance(node, ast.Assign) else node
            given.add(getattr(target, "name", None) or ast.unparse(getattr(target, "target", target)))
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "late":
            late += [(module, tuple(names)) for module, names in ast.literal_eval(node.args[1]).items()]
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            start = len("rf_exp.") + len(package.relative_to(ROOT / "rf_exp").as_posix()) + 1
            checked += [
                (each.module[start:], tuple(name.name for name in each.names))
                for each in node.body
                if isinstance(each, ast.ImportFrom) and each.module
            ]
    assert public_names(package) <= given
    assert late == checked


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


def test_no_file_of_tests_is_called_as_another() -> None:
    """The name alone says what failed."""
    called = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert not [name for name, times in called.items() if times > 1]
