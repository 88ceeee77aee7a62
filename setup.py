"""Packages, found: the repository root is the package, folder scene/ is splatview.scene, and so on."""

from setuptools import find_namespace_packages, setup

FLOORS = ("scene", "shaders", "raster", "edit", "measure", "trainer", "renderers", "viewer", "cli")
FOUND = find_namespace_packages(
    include=[name for floor in FLOORS for name in (floor, f"{floor}.*")],
    # Not even looked into: build/ has a link to the repository, for pyright.
    exclude=[f"{folder}*" for folder in ("build", "tests", "tools", "assets", "docs", "scripts")],
)

setup(packages=["splatview", *(f"splatview.{name}" for name in FOUND)], package_dir={"splatview": "."})
