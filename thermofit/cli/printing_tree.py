"""The datasets of an artefact as a tree on a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.text import Text
from rich.tree import Tree


def dataset_tree(datasets: Mapping[str, Mapping[str, Any]]) -> Tree:
    """Datasets by their folders, each with unit, axes and type."""
    root = Tree("datasets", style="", guide_style="dim")
    branches: dict[str, Tree] = {"": root}

    def branch(folder: str) -> Tree:
        if folder not in branches:
            above, _, own = folder.rpartition("/")
            branches[folder] = branch(above).add(Text(f"{own}/", style="bold"))
        return branches[folder]

    for name, data in datasets.items():
        folder, _, own = name.rpartition("/")
        axes = " x ".join(f"{dim} {size}" for dim, size in zip(data["dims"], data["shape"], strict=True)) or "scalar"
        unit = ", ".join(data.get("units", ())) or data["unit"]
        branch(folder).add(Text(f"{own}  [{unit}]  {axes}  {data['dtype']}"))
    return root
