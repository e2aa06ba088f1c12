"""nav2_msgs and tf2_msgs for a Python of ROS 2 from the package index, which has no such packages.

`python make_ros_packages.py FOLDER` generates the types that are needed from their definitions with
ROS's own generators and compiles them there; the folder then belongs on PYTHONPATH and
LD_LIBRARY_PATH. Their hashes come out as those that robots have, so they are these types and no
likeness of them.
"""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

# Package: the file of its only type, the hash that robots have for it, under the name of what is
# hashed, and the definition.
PACKAGES = {
    "nav2_msgs": (
        "action/NavigateToPose.action",
        "NavigateToPose_SendGoal",
        "RIHS01_a4fcb3bee1bf32e21a0e541a943b221aa0826996e2c98f079b47022b256f48b5",
        """\
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
""",
    ),
    "tf2_msgs": (
        "msg/TFMessage.msg",
        "TFMessage",
        "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
        "geometry_msgs/TransformStamped[] transforms\n",
    ),
}
NEEDS = (
    "builtin_interfaces", "geometry_msgs", "std_msgs", "unique_identifier_msgs", "action_msgs",
    "service_msgs",
)  # fmt: skip
# Each writes to a folder of its own: some of their files have the same names. In the order in which
# the libraries lean on each other: module, class, what it generates, where the sources are.
GENERATORS = (
    ("rosidl_generator_c", "GenerateC", "gcc", "*/detail/*.c"),
    ("rosidl_typesupport_fastrtps_c", "GenerateFastRTPSCTypesupport", "g++", "*/detail/*.cpp"),
    ("rosidl_typesupport_introspection_c", "GenerateIntrospectionCTypesupport", "gcc",
     "*/detail/*.c"),
    ("rosidl_typesupport_c", "GenerateCTypesupport", "g++", "*/*.cpp"),
    ("rosidl_generator_py", "GeneratePython", "gcc", "*/_*_s.c"),
)  # fmt: skip
SUPPORTS = (
    "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c",
)  # fmt: skip
RUNTIME = (
    "rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp", "rosidl_typesupport_introspection_c", "fastcdr", "rmw",
    "rcutils",
)  # fmt: skip


def generate(prefix: Path, folder: Path, package: str) -> None:
    """Write FOLDER/GENERATOR/PACKAGE for each, and the Python package to FOLDER/PACKAGE."""
    path, hashed, known, definition = PACKAGES[package]
    source = folder / "definition" / package / path
    source.parent.mkdir(parents=True)
    source.write_text(definition)
    files = [f"{source.parents[1]}:{path}"]
    for module, name, *_ in GENERATORS:
        generator = getattr(importlib.import_module(f"{module}.cli"), name)(module)
        generator.generate(package, files, [prefix / "share"], folder / module / package)
    described = folder / "rosidl_generator_c" / package / Path(path).parent / f"{hashed}.json"
    assert known in described.read_text(), "not the type that robots have"
    shutil.copytree(folder / "rosidl_generator_py" / package, folder / package)
    (folder / package / "__init__.py").touch()


def compile_all(prefix: Path, folder: Path, package: str) -> None:
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
        sources = sorted((folder / module / package).glob(pattern))
        build(compiler, sources, folder / f"lib{package}__{module}.so")
        links.insert(0, f"-l{package}__{module}")
    for kind in SUPPORTS:
        entry = folder / package / f"_{package}_s.ep.{kind}.c"
        build("gcc", [entry], folder / package / f"{package}_s__{kind}.so")


def main(folder: Path) -> None:
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        print(f"no Python.h for {sys.executable}: no packages can be made", file=sys.stderr)
        sys.exit(os.EX_UNAVAILABLE)
    prefix = Path(sys.prefix)
    os.environ["AMENT_PREFIX_PATH"] = str(prefix)
    for package in PACKAGES:
        generate(prefix, folder, package)
        compile_all(prefix, folder, package)


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
