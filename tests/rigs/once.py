"""Slow results, made by one of the processes of a test run and read from a file by the others."""

import os
import pickle
import time

PATIENCE = 600.0  # [s]


def once(factory, name, make):
    """Return the result of `make`; `factory` is pytest's `tmp_path_factory`."""
    folder = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:  # each worker has its own directory in that of the run
        folder = folder.parent
    made, mine = folder / f"{name}.pickle", folder / f"{name}.lock"
    end = time.monotonic() + PATIENCE
    while not made.exists():
        try:
            mine.touch(exist_ok=False)
        except FileExistsError:
            assert time.monotonic() < end, f"{name}: another process makes it for too long"
            time.sleep(0.1)
            continue
        try:
            whole = folder / f"{name}.part"
            whole.write_bytes(pickle.dumps(make()))
            whole.rename(made)
        finally:
            mine.unlink()
    return pickle.loads(made.read_bytes())
