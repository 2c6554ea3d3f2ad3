"""SIGTERM and SIGUSR1 end a command behind the evaluation that is under way; where none is kept, at once."""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from thermofit.records import stopping
from thermofit.records.checkpoint import Checkpoint
from thermofit.records.stopping import Stopped, stoppable

SIGNALS = (signal.SIGTERM, signal.SIGUSR1)


def send(number: int) -> None:
    """To this process, and wait until Python has heard it."""
    os.kill(os.getpid(), number)
    time.sleep(0.01)


@pytest.mark.parametrize("number", SIGNALS)
def test_evaluation_under_way_is_kept(tmp_path: Path, number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with pytest.raises(Stopped, match=number.name), stoppable():
        store = Checkpoint(tmp_path / "c", "key")
        store.put(np.zeros(1), y=np.ones(1))
        send(number)
        store.put(np.ones(1), y=np.ones(1))
    assert Checkpoint(tmp_path / "c", "key").count == 2
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", SIGNALS)
def test_nothing_is_kept_so_it_ends_at_once(number: signal.Signals) -> None:
    gc.collect()  # those that keep evaluations of other tests
    with pytest.raises(Stopped, match=number.name), stoppable():
        send(number)
        pytest.fail("it went on")


def test_second_signal_and_grace_end_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stopping, "GRACE_S", 0.05)
    store = Checkpoint(tmp_path / "c", "key")
    with pytest.raises(Stopped), stoppable():
        send(signal.SIGUSR1)
        send(signal.SIGUSR1)
        pytest.fail("it went on")
    with pytest.raises(Stopped, match="SIGTERM"), stoppable():
        send(signal.SIGTERM)
        time.sleep(5.0)
        pytest.fail("it went on")
    with stoppable():  # what was asked of an earlier command is forgotten
        store.put(np.zeros(1), y=np.ones(1))


def test_interrupt_in_a_finaliser_is_not_lost() -> None:
    class Slow:
        def __del__(self) -> None:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)

    with pytest.raises(KeyboardInterrupt), stoppable():
        Slow()
        time.sleep(5.0)
        pytest.fail("it went on")


def test_interrupt_that_a_library_wraps_is_one() -> None:
    with pytest.raises(Stopped, match="SIGINT"), stoppable():
        try:
            send(signal.SIGINT)
        except KeyboardInterrupt:
            raise ValueError("SchemaError: KeyboardInterrupt:") from None
    with pytest.raises(ValueError, match="of its own"), stoppable():
        raise ValueError("of its own")


def test_other_threads_hear_nothing() -> None:
    before = signal.getsignal(signal.SIGTERM)
    seen = []

    def run() -> None:
        with stoppable():
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [before]
