# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Packaging for pip and for colcon (build type ament_python); all metadata stands here."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "puma_sim_ros"  # colcon and `ros2 run` want the <name> of package.xml
ROOT = Path(__file__).resolve().parent

# read, not imported: the build environment has none of the run-time dependencies
VERSION = re.search(
    r'^__version__ = "([^"]+)"$', (ROOT / "puma_sim_core" / "__init__.py").read_text(encoding="utf-8"), re.MULTILINE
).group(1)

README = ROOT / "README.md"

CONFIG_FILES = sorted(path for path in (ROOT / "config").rglob("*") if path.suffix in (".yaml", ".json", ".rviz"))


def _share_files():
    """(installed folder, files) of config/, one entry for each of its folders."""
    folders = {}
    for path in CONFIG_FILES:
        relative = path.relative_to(ROOT)
        folders.setdefault(f"share/{NAME}/{relative.parent.as_posix()}", []).append(relative.as_posix())
    return sorted(folders.items())


setup(
    name=NAME,
    version=VERSION,
    description="The PUMA 560's first three joints with their DC motors, simulated, as a ROS 2 "
    "node and as a Python library",
    long_description=README.read_text(encoding="utf-8") if README.exists() else "",
    long_description_content_type="text/markdown",
    author="puma-sim maintainers",
    author_email="maintainers@puma-sim.example",
    maintainer="puma-sim maintainers",
    maintainer_email="maintainers@puma-sim.example",
    license="Apache-2.0",
    license_files=["LICENSE"],
    keywords=["robotics", "simulation", "PUMA 560", "manipulator", "ROS 2"],
    classifiers=[
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering",
    ],
    python_requires=">=3.10",
    # config/ stands at the top of the source tree and is installed inside puma_sim_core, where
    # puma_sim_core.resources looks for it
    packages=[*find_packages(include=["puma_sim_core*", "puma_sim_ros*"]), "puma_sim_core.config"],
    package_dir={"puma_sim_core.config": "config"},
    package_data={
        # texts and tables of the thesis, sentences about effects, templates of the pages
        "puma_sim_core": ["py.typed", "**/*.yaml", "**/*.html", "**/*.css", "**/*.js", "*.pyi"],
        "puma_sim_ros": ["py.typed", "**/*.yaml", "*.xml"],
        "puma_sim_core.config": [path.relative_to(ROOT / "config").as_posix() for path in CONFIG_FILES],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *_share_files(),
        (f"share/{NAME}/launch", ["launch/sim.launch.py", "launch/demo.launch.py"]),
    ],
    zip_safe=False,
    install_requires=[
        "numpy>=1.26",
        "scipy",
        "PyYAML",
        "mcap>=1.5",
        "rosbags>=0.11",
        "jinja2>=3.1",
        "matplotlib>=3.6",
        "rich>=12",
        "threadpoolctl>=3",
    ],
    extras_require={
        "fast": ["numba"],
        # jobs on a cluster: --scheduler
        "cluster": ["dask[distributed]"],
        # pages in the browser; viser carries its own client, so that no network is needed
        "view": ["viser>=1.1,<2"],
        # shells complete the command line
        "completion": ["argcomplete>=3"],
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "lint": ["ruff>=0.17", "mypy>=2.4", "import-linter>=2.16", "codespell>=2.4", "pre-commit"],
        "docs": ["sphinx>=7", "myst-parser"],
        "test": [
            "argcomplete>=3",
            "pytest",
            "pytest-timeout",
            "pytest-xdist",
            "pytest-cov",
            "control>=0.10.2",
            "hypothesis",
            "jsonschema",
            "mcap-ros2-support",
            "mujoco>=3.7",
            "pin",
            "dask[distributed]",
            "viser>=1.1,<2",
            "catkin-pkg",
            "setuptools>=64",
            "wheel",
        ],
    },
    entry_points={
        "console_scripts": [
            "puma-sim = puma_sim_core.cli:main",
            "sim_node = puma_sim_ros.sim_node:main",
            "external_controller = puma_sim_ros.external_controller:main",
            "viewer = puma_sim_ros.viewer:main",
            "appraise = puma_sim_ros.appraise:main",
            "appraised_controller = puma_sim_ros.appraised_controller:main",
        ]
    },
    # `ros2 run` looks in lib/<package>. colcon calls `setup.py install` or `develop`, which obey
    # this (also in a virtual environment, where the same lines in setup.cfg would be ignored);
    # pip makes the scripts from the wheel's entry points and puts them on PATH.
    options={"develop": {"script_dir": f"$base/lib/{NAME}"}, "install": {"install_scripts": f"$base/lib/{NAME}"}},
)
