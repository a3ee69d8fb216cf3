"""Layout of the package: imports, public names, size of folders, attributes set outside of __init__."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import LONG

ROOT = Path(__file__).parents[1]
SOURCES = {
    path: ast.parse(path.read_text("utf-8"))
    for folder in ("rf_exp", "docs", "examples", "plugins")  # benchmarks and tests may import private names
    for path in sorted((ROOT / folder).rglob("*.py"))
}
PACKAGES = {path.parent: tree for path, tree in SOURCES.items() if path.name == "__init__.py"}
STUBS = {  # of packages with lazy imports
    path.parent: ast.parse(path.read_text("utf-8")) for path in (ROOT / "rf_exp").rglob("__init__.pyi")
}
RF_EXP_FILES = [path for path in SOURCES if path.is_relative_to(ROOT / "rf_exp")]
CLASSES = [
    node for path in RF_EXP_FILES for node in ast.walk(SOURCES[path]) if isinstance(node, ast.ClassDef)
]
MOST_MODULES = 14  # per folder, including its stub
# Modules that are added without an edit elsewhere; tasks, assets and constraints do not count for the limit.
EXTENSIBLE_FOLDERS = ("conf/task", "rf_exp/tasks/assets", "rf_exp/constraints/checks")
EXTENSIONS = {path.stem for each in EXTENSIBLE_FOLDERS for path in (ROOT / each).iterdir()} - {
    "__init__",
    "__main__",
}
CONSTRUCTORS = {"__init__", "__post_init__", "__new__"}


def short_path(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def stub_entries(package: Path) -> list[tuple[str, ast.alias]]:
    """The entries (inner module, name) of a stub; the inner module is empty for a module itself."""
    nodes = [node for node in STUBS[package].body if isinstance(node, ast.ImportFrom) and node.level == 1]
    assert len(nodes) == len(STUBS[package].body), (
        f"{short_path(package)}: a stub holds imports of inner modules"
    )
    return [(node.module or "", each) for node in nodes for each in node.names]


def defined_names(tree: ast.Module) -> set[str]:
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
    """The public names of a package: those of its stub or of its `__all__`; empty if it has neither."""
    if package in STUBS:
        return {each.asname or each.name for _, each in stub_entries(package)}
    for node in PACKAGES[package].body:
        if isinstance(node, ast.Assign) and [ast.unparse(each) for each in node.targets] == ["__all__"]:
            return set(ast.literal_eval(node.value))
    return set()


def imported_names(tree: ast.AST) -> Iterator[str]:
    """The full names that a module imports from `rf_exp`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = [f"{node.module}.{each.name}" for each in node.names]
        else:
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
        yield from (name for name in names if name.startswith("rf_exp."))


def is_public(name: str, importer: Path) -> bool:
    """Whether each package on the path to a name exports the next part of it to modules outside of it.

    An inner package counts as a package only if it exports names, otherwise as a folder.
    """
    folder = ROOT / "rf_exp"
    for part in name.split(".")[1:]:
        is_package = folder in PACKAGES and (folder.parent == ROOT / "rf_exp" or public_names(folder))
        if is_package and not importer.is_relative_to(folder) and part not in public_names(folder):
            return False
        folder = folder / part
    return True


def test_only_public_names_are_imported_from_other_packages() -> None:
    wrong = [
        f"{short_path(path)}: {name}"
        for path, tree in SOURCES.items()
        for name in imported_names(tree)
        if not is_public(name, path)
    ]
    assert not wrong, "\n".join(wrong)


def test_tests_and_benchmarks_import_public_names_from_their_package() -> None:
    """Public names are imported from their package, so that their definition may move within it."""
    paths = [path for folder in ("tests", "benchmarks") for path in sorted((ROOT / folder).rglob("*.py"))]
    wrong = []
    for path in paths:
        for name in imported_names(ast.parse(path.read_text("utf-8"))):
            package, attribute = ROOT / "rf_exp" / name.split(".")[1], name.split(".")[-1]
            if not is_public(name, path) and attribute in public_names(package):
                wrong.append(
                    f"{short_path(path)}: {name} is given by {short_path(package)}; import it from there"
                )
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("package", [each for each in PACKAGES if public_names(each)], ids=short_path)
def test_public_names_of_a_package_exist(package: Path) -> None:
    """Lazy imports are listed once, in the stub that the type checker also reads."""
    if package not in STUBS:
        assert public_names(package) <= defined_names(PACKAGES[package])
        return
    for module, each in stub_entries(package):
        inner = package / (module or each.name).replace(".", "/")
        is_package = inner / "__init__.py" in SOURCES  # a folder with old bytecode only is none
        tree = SOURCES[inner / "__init__.py" if is_package else inner.with_suffix(".py")]
        assert each.asname == each.name, (
            f"{short_path(package)}: import {each.name} as {each.name}, or it is kept"
        )
        assert not module or each.name in (public_names(inner) if is_package else defined_names(tree))
    assert not [
        name for name, times in Counter(each.name for _, each in stub_entries(package)).items() if times > 1
    ]
    assert defined_names(PACKAGES[package]) == {"__getattr__", "__dir__", "__all__"}


def test_no_folder_has_too_many_modules() -> None:
    """Several modules of one concept are in a folder named after the concept."""
    modules = [*RF_EXP_FILES, *(package / "__init__.pyi" for package in STUBS)]
    counts = Counter(path.parent for path in modules if path.stem not in EXTENSIONS)
    too_full = [
        f"{short_path(folder)}: {number}" for folder, number in counts.items() if number > MOST_MODULES
    ]
    assert not too_full, f"at most {MOST_MODULES} modules a folder: {', '.join(too_full)}"


def assigned_attributes(method: ast.FunctionDef) -> set[str]:
    """The attributes of self that a method assigns."""
    if not method.args.args or any(ast.unparse(each) == "staticmethod" for each in method.decorator_list):
        return set()
    declared = {
        each.target for each in ast.walk(method) if isinstance(each, ast.AnnAssign) and not each.value
    }
    return {
        each.attr
        for each in ast.walk(method)
        if isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store) and each not in declared
        if ast.unparse(each.value) == method.args.args[0].arg
    }


def initial_attributes(cls: ast.ClassDef) -> set[str]:
    """The attributes that every object of a class has after construction, including those of base classes."""
    fields = any("dataclass" in ast.unparse(each) for each in cls.decorator_list)
    names: set[str] = set()
    for node in cls.body:
        if isinstance(node, ast.AnnAssign) and (fields or node.value):
            names.add(ast.unparse(node.target))
        elif isinstance(node, ast.Assign):
            names |= {ast.unparse(each) for each in node.targets}
        elif isinstance(node, ast.FunctionDef):
            # Other functions may be properties, with a setter.
            names |= assigned_attributes(node) if node.name in CONSTRUCTORS else {node.name}
    bases = {ast.unparse(base).split("[")[0].rsplit(".")[-1] for base in cls.bases}
    for parent in CLASSES:
        names |= initial_attributes(parent) if parent.name in bases - {cls.name} else set()
    return names


def test_no_attribute_is_first_set_outside_of_init() -> None:
    """All attributes are set in one place, and none is missing before a method has been called.

    State that a method recreates, such as that of an episode, is a separate object in one attribute.
    """
    late = [
        f"{cls.name}.{method.name} is the first to set self.{name} (line {method.lineno}); set it in __init__"
        for cls in CLASSES
        for method in cls.body
        if isinstance(method, ast.FunctionDef) and method.name not in CONSTRUCTORS
        for name in sorted(assigned_attributes(method) - initial_attributes(cls))
    ]
    assert not late, "\n".join(late)


def test_the_longest_modules_of_tests_exist() -> None:
    assert {*LONG} <= {path.stem for path in (ROOT / "tests").rglob("test_*.py")}


def test_file_names_of_tests_are_unique() -> None:
    """The name of a file identifies a failed test."""
    counts = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert not [name for name, times in counts.items() if times > 1]
