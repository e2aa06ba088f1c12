"""nav2_msgs for a Python of ROS 2 that comes from the package index, which has no such package.

`python ros_messages.py FOLDER` generates the action NavigateToPose from its definition with ROS's
own generators and compiles it there; the folder then belongs on PYTHONPATH and LD_LIBRARY_PATH. The
hash of the type comes out as the one that robots have, so it is that type and no likeness of it.
"""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

PACKAGE = "nav2_msgs"
HASH = "RIHS01_a4fcb3bee1bf32e21a0e541a943b221aa0826996e2c98f079b47022b256f48b5"
DEFINITION = """\
geometry_msgs/PoseStamped pose
string behavior_tree
---
uint16 NONE=0
uint16 error_code
string error_msg
---
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
"""
NEEDS = (
    "builtin_interfaces", "geometry_msgs", "std_msgs", "unique_identifier_msgs", "action_msgs",
    "service_msgs",
)  # fmt: skip
# Each writes to a folder of its own: some of their files bear the same names. In the order in which
# the libraries lean on each other: module, class, what it generates, where the sources are.
GENERATORS = (
    ("rosidl_generator_c", "GenerateC", "gcc", "action/detail/*.c"),
    ("rosidl_typesupport_fastrtps_c", "GenerateFastRTPSCTypesupport", "g++", "action/detail/*.cpp"),
    ("rosidl_typesupport_introspection_c", "GenerateIntrospectionCTypesupport", "gcc",
     "action/detail/*.c"),
    ("rosidl_typesupport_c", "GenerateCTypesupport", "g++", "action/*.cpp"),
    ("rosidl_generator_py", "GeneratePython", "gcc", "action/_*_s.c"),
)  # fmt: skip
SUPPORTS = (
    "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c",
)  # fmt: skip
RUNTIME = (
    "rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_c", "fastcdr", "rmw",
    "rcutils",
)  # fmt: skip


def generate(prefix: Path, folder: Path) -> None:
    """Write FOLDER/GENERATOR/nav2_msgs for each, and the Python package to FOLDER/nav2_msgs."""
    source = folder / "definition" / "action"
    source.mkdir(parents=True)
    (source / "NavigateToPose.action").write_text(DEFINITION)
    files = [f"{source.parent}:action/NavigateToPose.action"]
    for module, name, *_ in GENERATORS:
        generator = getattr(importlib.import_module(f"{module}.cli"), name)(module)
        generator.generate(PACKAGE, files, [prefix / "share"], folder / module / PACKAGE)
    described = folder / "rosidl_generator_c" / PACKAGE / "action" / "NavigateToPose_SendGoal.json"
    assert HASH in described.read_text(), "not the type that robots have"
    shutil.copytree(folder / "rosidl_generator_py" / PACKAGE, folder / PACKAGE)
    (folder / PACKAGE / "__init__.py").touch()


def compile_all(prefix: Path, folder: Path) -> None:
    """One library for each generator, and Python's extensions."""
    import numpy

    headers = [prefix / "include", *(prefix / "include").glob("*/")]
    headers += [folder / module for module, *_ in GENERATORS]
    headers += [Path(sysconfig.get_path("include")), Path(numpy.get_include())]
    include = [f"-I{path}" for path in headers]
    search = [f"-L{prefix}/lib", f"-L{folder}", f"-Wl,-rpath,{folder}:{prefix}/lib"]
    there = {path.name[3:-3] for path in (prefix / "lib").glob("lib*.so")}
    kinds = [module for module, *_ in GENERATORS]
    wanted = [*(f"{need}__{kind}" for need in NEEDS for kind in kinds), *RUNTIME]
    links = [f"-l{name}" for name in wanted if name in there]

    def build(compiler: str, sources: list[Path], library: Path) -> None:
        assert sources, f"nothing was generated for {library}"
        command = [compiler, "-O0", "-shared", "-fPIC", "-w", *include, *map(str, sources)]
        subprocess.run([*command, "-o", str(library), *search, *links], check=True)

    for module, _, compiler, pattern in GENERATORS:
        sources = sorted((folder / module / PACKAGE).glob(pattern))
        build(compiler, sources, folder / f"lib{PACKAGE}__{module}.so")
        links.insert(0, f"-l{PACKAGE}__{module}")
    for kind in SUPPORTS:
        entry = folder / PACKAGE / f"_{PACKAGE}_s.ep.{kind}.c"
        build("gcc", [entry], folder / PACKAGE / f"{PACKAGE}_s__{kind}.so")


def main(folder: Path) -> None:
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        print(f"no Python.h for {sys.executable}: nav2_msgs cannot be made", file=sys.stderr)
        sys.exit(os.EX_UNAVAILABLE)
    prefix = Path(sys.prefix)
    os.environ["AMENT_PREFIX_PATH"] = str(prefix)
    generate(prefix, folder)
    compile_all(prefix, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
