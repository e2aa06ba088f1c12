"""The house rules of `exporters`: no circle at any depth, and no library imports its script."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import exporters

ROOT = Path(exporters.__file__).parent


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_name(path): path for path in ROOT.rglob("*.py")}


def imports_of(module: str) -> set[str]:
    """Return the modules of `exporters` that one imports, inside functions as well."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[module].read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= inner & MODULES.keys() or {node.module}
    return found & MODULES.keys() - {module}


def test_no_module_imports_a_script():
    importers = {m: imports_of(m) for m in MODULES}
    assert not [m for m, found in importers.items() if any("__main__" in n for n in found)]


def test_no_packages_form_a_circle_at_any_depth():
    """A package's modules are visible to its parent's siblings: `training.mini` is one."""
    for depth in range(1, 4):
        graph: dict[str, set[str]] = {}
        for module in MODULES:
            own = ".".join(module.split(".")[: depth + 1])
            seen = {".".join(name.split(".")[: depth + 1]) for name in imports_of(module)}
            graph.setdefault(own, set()).update(seen - {own, "exporters"})
        tuple(TopologicalSorter(graph).static_order())  # raises CycleError
