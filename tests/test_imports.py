"""Imports follow the flow of data: a package imports what stands before it, and nothing after."""

import ast
from pathlib import Path

import pytest

ORDER = [
    *("errors", "rows", "files", "cache", "plain_yaml", "targets", "config", "machine_code"),
    *("tracks", "sim", "racing", "task", "log", "render", "env", "algorithms", "data"),
    *("evaluation", "train", "opponents", "report", "export", "cli"),
    *("registration", "sb3"),
    "__init__",
]
"""Packages and the modules beside them, in the order in which they may import each other."""


@pytest.mark.parametrize("path", sorted(Path("carrl").rglob("*.py")), ids=str)
def test_imports_follow_the_flow_of_data(path):
    layer = ORDER.index(path.parts[1].removesuffix(".py"))
    for name in imported(path):
        place = name.split(".")[1]
        assert place in ORDER and ORDER.index(place) <= layer, f"{path} imports {name}"


def test_no_module_imports_itself_by_way_of_others():
    graph = {
        ".".join(path.with_suffix("").parts).removesuffix(".__init__"): set(imported(path, at_once=True))
        for path in Path("carrl").rglob("*.py")
    }
    graph = {module: {near for near in wanted if near in graph and near != module} for module, wanted in graph.items()}
    while free := [module for module, wanted in graph.items() if not wanted & graph.keys()]:
        for module in free:
            del graph[module]
    assert not graph, f"modules that import each other are among {sorted(graph)}"


def imported(path, at_once=False):
    """Modules of CarRL that a file imports: all, or those that are imported as soon as it is."""
    tree = ast.parse(path.read_text())
    nodes = list(tree.body) if at_once else list(ast.walk(tree))
    for node in nodes:
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if is_module(name) else node.module for name in names]
        else:
            continue
        yield from (name for name in names if name.startswith("carrl."))


def is_module(name):
    """Whether a dotted name is that of a module or package here."""
    path = Path(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()
