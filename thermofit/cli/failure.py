"""What the user reads when something goes wrong: one sentence, and the exit code that says whose turn it is."""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

import typer

from thermofit.core.errors import NumericsError, StudyError, ThermofitError, UntrustworthyError
from thermofit.records.stopping import stoppable

TRACEBACK_VARIABLE = "THERMOFIT_TRACEBACK"
"""Environment variable: where it is set, an unexpected exception shows where it came from."""

INTERRUPTED = 130
UNTRUSTWORTHY = UntrustworthyError.exit_code


@contextmanager
def reporting(as_json: bool) -> Iterator[None]:
    """Turn exceptions of the block into one sentence on stderr (with --json also an object on stdout) and an exit code."""
    try:
        with stoppable():
            yield
    except (typer.Exit, typer.Abort, BrokenPipeError):
        raise
    except ThermofitError as error:
        _fail(str(error), error.exit_code, as_json)
    except KeyboardInterrupt as error:
        by = f" by {error}" if str(error) else ""
        _fail(f"interrupted{by}; finished evaluations are kept, the same command resumes", INTERRUPTED, as_json)
    except MemoryError as error:
        text = "the memory does not suffice; take a coarser mesh (--set mesh=coarse) or fewer observation times"
        _fail(f"{text} ({error})" if str(error) else text, NumericsError.exit_code, as_json)
    except OSError as error:
        where = f"'{error.filename}'" if error.filename else "a file"
        reason = error.strerror or str(error) or type(error).__name__
        _fail(
            f"{where} cannot be read or written: {reason}; free the space, correct the rights or take another --run-dir",
            StudyError.exit_code,
            as_json,
        )
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            traceback.print_exc()
        hint = f"set {TRACEBACK_VARIABLE}=1 and run it again to see where, and report it with that text"
        _fail(f"unexpected {type(error).__name__}: {error or 'without a text'}; a mistake of thermofit, not yours: {hint}", 1, as_json)


def _fail(text: str, exit_code: int, as_json: bool) -> None:
    """Print the sentence and end the command."""
    sentence = " ".join(text.split())
    if as_json:
        typer.echo(json.dumps({"error": sentence, "exit_code": exit_code}))
    print(f"error: {sentence}", file=sys.stderr)
    raise typer.Exit(exit_code) from None
