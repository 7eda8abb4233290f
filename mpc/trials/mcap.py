"""Runs as MCAP files: one channel of JSON messages with a schema, which Foxglove and PlotJuggler plot."""

import json
from pathlib import Path

import numpy as np

from allocator.files.atomic import replacing
from mpc.trials.simulation import Run

TOPIC = "/joint"
_NANO = 1_000_000_000


def save_mcap(run: Run, path: str | Path, begin: int = 0) -> None:
    """Write a message per sample with the columns of `Run.to_dict`, which the schema names with their units.

    The first sample is at `begin` [ns] since 1970. NaN is left out of a message, since JSON cannot represent it. Raises
    `CannotWrite`, and `MissingPackage` without the package mcap.
    """
    from mcap.writer import Writer

    table = run.to_dict()
    names = [name for name in table if name != "t"]
    rows = np.stack([np.asarray(table[name], float) for name in names], axis=1)
    schema = {"type": "object", "properties": {name: {"type": "number"} for name in names}}
    with replacing(path) as draft, draft.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="antagonist")
        kind = writer.register_schema("antagonist.Joint", "jsonschema", json.dumps(schema).encode())
        channel = writer.register_channel(TOPIC, "json", kind)
        for t, row in zip(np.asarray(table["t"], float).tolist(), rows.tolist(), strict=True):
            time = begin + round(t * _NANO)
            message = {name: value for name, value in zip(names, row, strict=True) if np.isfinite(value)}
            writer.add_message(channel, time, json.dumps(message).encode(), time)
        writer.finish()
