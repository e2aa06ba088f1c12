"""The house rules of `edge` and `exporters`: permitted imports, and the size of classes."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import edge
import exporters
from edge.cli.options import EXTRAS

ROOT, EXPORTERS = (Path(package.__file__).parent for package in (edge, exporters))
# A package imports from itself and from the lines above its own.
LAYERS = (
    ("__init__", "errors", "text", "geometry", "types", "logs", "number_words"),
    ("names", "stuck", "jit"),
    ("host",),
    ("config",),
    ("bus", "chat"),
    ("mapping", "perception", "trajectory"),
    ("memory",),
    ("policies", "mission"),
    ("tasks",),
    ("loop",),
    ("recording",),
    ("sources", "sinks", "ros2_adapter", "fleet"),
    ("live",),
    ("launch",),
    ("models",),
    ("cli",),
    ("mcp_server",),
    ("lab",),
)
LEVEL = {name: level for level, layer in enumerate(LAYERS) for name in layer}
MOST_AT_THE_TOP = 12
MOST_METHODS = 20
# Only code that makes a model may import the exporters' packages.
NEVER = {"exporters", "torch", "transformers", "ultralytics"}


def modules_of(root: Path) -> dict[str, Path]:
    """Return the files of a package, by module."""
    files = {path.relative_to(root.parent).with_suffix(""): path for path in root.rglob("*.py")}
    return {".".join(name.parts).removesuffix(".__init__"): path for name, path in files.items()}


BOTH = {"edge": modules_of(ROOT), "exporters": modules_of(EXPORTERS)}
MODULES = BOTH["edge"]
PACKAGES = sorted(
    name for modules in BOTH.values() for name, path in modules.items() if path.stem == "__init__"
)


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements inside a node at any depth; `ast.walk` takes three times as long."""
    for field in ("body", "orelse", "finalbody", "handlers", "cases"):
        for inner in getattr(node, field, ()):
            yield inner
            yield from statements(inner)


# Parsing all modules takes 25 times as long, in each worker.
IMPORT = re.compile(
    r"^[ \t]*(?:from ([\w.]+) import (\([^)]*\)|.+)|import (.+))[ \t]*$", re.MULTILINE
)


def imports_of(module: str, modules: dict[str, Path]) -> Iterator[str]:
    """Modules that a module imports, anywhere: inside functions and for types as well."""
    source = re.sub("#.*", "", modules[module].read_text(encoding="utf-8"))
    for origin, names, whole in IMPORT.findall(source):
        assert not origin.startswith("."), f"{module}: relative import"
        for name in filter(None, map(str.strip, (names or whole).strip("() \n").split(","))):
            imported = ".".join(filter(None, (origin, name.split()[0])))
            yield imported if imported in modules or not origin else origin


def test_imports_are_read_as_python_reads_them():
    for module in ("edge.launch", "edge.loop.service", "edge.mission.language.errands.spell_out"):
        tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
        named = {alias.name for node in statements(tree) if isinstance(node, ast.Import)
                 for alias in node.names}  # fmt: skip
        for node in statements(tree):
            if isinstance(node, ast.ImportFrom):
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                named |= {name if name in MODULES else str(node.module) for name in inner}
        assert {*imports_of(module, MODULES)} == named


@cache
def imports(root: str = "edge") -> dict[str, set[str]]:
    """Return each module's imports; every worker that collects tests reads this file."""
    return {module: {*imports_of(module, BOTH[root])} - {module} for module in BOTH[root]}


def room(module: str) -> str:
    return module.split(".")[1] if "." in module else "__init__"


def test_every_room_has_its_place():
    rooms = {room(module) for module in MODULES}
    assert rooms == set(LEVEL)
    at_the_top = [path for path in ROOT.glob("*.py") if path.name != "__init__.py"]
    assert len(at_the_top) <= MOST_AT_THE_TOP


def test_no_import_runs_upward():
    """Only the CLI imports `edge.lab`, when a verb needs it."""
    upward = sorted(
        f"{module} -> {target}"
        for module, targets in imports().items()
        for target in targets & MODULES.keys()
        if room(module) != room(target)
        and LEVEL[room(module)] <= LEVEL[room(target)] != 0
        and (room(module), room(target)) != ("cli", "lab")
    )
    assert upward == []


def test_no_imports_form_a_circle():
    inside = {module: targets & MODULES.keys() for module, targets in imports().items()}
    try:
        tuple(TopologicalSorter(inside).static_order())
    except CycleError as circle:
        pytest.fail(" -> ".join(circle.args[1]))


@pytest.mark.parametrize("package", PACKAGES)
def test_no_children_of_a_package_form_a_circle(package):
    """The sub-packages and modules of a package, each taken as one."""
    graph: dict[str, set[str]] = {}
    found = imports(package.partition(".")[0])
    for module, targets in found.items():
        if name := child(package, module):
            inside = {child(package, target) for target in targets & found.keys()}
            graph.setdefault(name, set()).update(inside - {"", name})
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as circle:
        pytest.fail(" -> ".join(circle.args[1]))


def child(package: str, module: str) -> str:
    """Return the child of a package that a module belongs to; empty if it is outside."""
    return module[len(package) + 1 :].split(".")[0] if module.startswith(f"{package}.") else ""


def test_the_loop_loads_no_zenoh():
    reached, new = set(), {module for module in MODULES if room(module) == "loop"}
    while new:
        reached |= new
        new = set().union(*(imports().get(module, set()) for module in new)) - reached
    assert "zenoh" not in reached


def test_the_robot_code_imports_no_exporter():
    reached = {t.split(".")[0] for targets in imports().values() for t in targets}
    assert not reached & NEVER


def test_no_exporter_imports_a_script():
    targets = set().union(*imports("exporters").values())
    assert not [name for name in targets if name.startswith("exporters.") and "__main__" in name]


def test_only_lab_imports_packages_of_the_lab_extra():
    outside = sorted(
        f"{module} -> {target}"
        for module, targets in imports().items()
        for target in targets
        if room(module) != "lab" and target.split(".")[0] in EXTRAS["lab"]
    )
    assert outside == []


def test_edge_run_loads_no_lab():
    # numba looks for SciPy at its import, and does without.
    code = "import sys, numba; before = set(sys.modules); import edge.cli.commands; "
    code += "print(*set(sys.modules) - before)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {*ran.stdout.split()}
    assert "edge.loop.service" in loaded
    heavy = ("edge.lab", *EXTRAS["lab"], "pandas", "mcp", "edge.mcp_server")
    assert not [name for name in loaded if name.startswith(heavy)]


@pytest.mark.parametrize("package", sorted(p.parent for p in ROOT.rglob("__init__.py")), ids=str)
def test_every_package_has_a_docstring(package):
    assert ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8")))


def test_the_node_of_the_ros2_adapter_imports_names_that_exist():
    """Without running it: it needs the Python of ROS 2."""
    trees = {
        path.stem: ast.parse(path.read_text()) for path in (ROOT / "ros2_adapter/node").glob("*.py")
    }
    imported = {
        (node.module, alias.name)
        for tree in trees.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in trees
        for alias in node.names
    }
    defined = {
        (module, node.name)
        for module, tree in trees.items()
        for node in tree.body
        if isinstance(node, (ast.ClassDef, ast.FunctionDef))
    }
    assert imported
    assert imported <= defined


def crowded(source: str) -> list[tuple[str, int]]:
    """Return name and number of methods of the classes with more than `MOST_METHODS`."""
    if source.count("def ") <= MOST_METHODS:
        return []
    numbers = [
        (node.name, sum(isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef) for n in node.body))
        for node in statements(ast.parse(source))
        if isinstance(node, ast.ClassDef)
    ]
    return [(name, n) for name, n in numbers if n > MOST_METHODS]


@pytest.mark.parametrize(("methods", "found"), [(0, []), (20, []), (21, [("Tracker", 21)])])
def test_methods_are_counted(methods, found):
    body = "".join(f"    async def f{n}(self):\n        def inner(): ...\n" for n in range(methods))
    assert crowded(f"class Tracker:\n    limit = 3\n{body}") == found


def test_no_class_has_more_methods_than_a_reader_can_hold():
    found = [
        (str(path.relative_to(ROOT.parent)), *one)
        for folder in (ROOT, ROOT.parent / "exporters")
        for path in sorted(folder.rglob("*.py"))
        for one in crowded(path.read_text(encoding="utf-8"))
    ]
    assert found == []
