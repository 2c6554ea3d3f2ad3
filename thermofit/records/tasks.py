"""A task that any process can do: a call and its answer by value."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from thermofit.core.errors import ThermofitError
from thermofit.core.jit import set_threads

LOSSES = 3
"""How many times a task may lose its worker before it is given up."""


@dataclass(frozen=True)
class Task:
    """`function(*arguments)`; the function stands at the top of a module of thermofit, the arguments are plain data (pickled).

    `label` names it for the user: "start 3".
    """

    label: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()


def answer_of(task: Task, threads: int) -> tuple[bool, Any]:
    """(True, answer) or (False, error) of a task in a worker; an unexpected error comes as a text with its place."""
    try:
        set_threads(threads)
        return True, task.function(*task.arguments)
    except ThermofitError as error:
        return False, error
    except Exception:
        return False, RuntimeError(f"{task.label}, in a worker:\n{traceback.format_exc()}")


def lost_text(label: str, how: str) -> str:
    """What the user reads of a task that cannot keep a worker."""
    return (
        f"{label}: its worker was lost {LOSSES} times ({how}), which a kill or too little memory does; what is finished is kept: give each "
        "worker more memory or run fewer at once, and the same command resumes"
    )
