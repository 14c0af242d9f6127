"""What the workspace promises of its distributions: declared dependencies and light imports."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.metadata import distributions, requires

import grimp
import pytest

PACKAGES = {"moral_envs": "moral-envs", "moral_algorithms": "moral-algorithms"}


def declared(distribution: str) -> set[str]:
    """Return the normalised names of a distribution's dependencies, those of its extras included."""
    names = (re.match(r"[\w.-]+", requirement) for requirement in requires(distribution) or [])
    return {normalised(name.group()) for name in names if name}


def normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def modules_of(names: set[str]) -> set[str]:
    """Find what installed distributions bring, by their normalised names.

    By their files: in Python 3.10 `importlib.metadata.packages_distributions` does not know all of them.
    """
    installed = [one for one in distributions() if normalised(one.metadata["Name"]) in names]
    # What is installed in place lists no package of its own.
    own = {one.metadata["Name"].replace("-", "_") for one in installed}
    return own | {file.parts[0].removesuffix(".py") for one in installed for file in one.files or ()}


@pytest.mark.parametrize(("package", "distribution"), PACKAGES.items())
def test_a_package_imports_only_what_its_distribution_declares(package: str, distribution: str) -> None:
    graph = grimp.build_graph(package, include_external_packages=True, cache_dir=None)
    imported = {name for name in graph.modules if graph.is_module_squashed(name)} - sys.stdlib_module_names
    provided = modules_of(declared(distribution))
    undeclared = imported - provided
    assert "numpy" in imported & provided
    assert not undeclared


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("moral_envs", {"torch", "pygame", "stable_baselines3", "matplotlib"}),
        ("moral_algorithms.preferences", {"torch", "stable_baselines3"}),
    ],
)
def test_an_import_does_not_load_heavy_libraries(module: str, unwanted: set[str]) -> None:
    code = f"import sys, {module}; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert module in loaded
    assert not unwanted & loaded
