"""Topics of recordings of robots: ROS 1 bags, ROS 2 bags and MCAP files, as columns of a table.

A quantity is a number in the messages of one topic, `theta=/joint_states.position[0]`, with a unit unless it is SI,
`pressure1=/valves.data[2]:bar`. Messages are read in order, and only the numbers are kept. Times are those at which a
message was recorded.

Topics have different times. The table has a row for every message of the first quantity's topic, with the others' last
earlier values; a row is left out if one of these is older than `_STALE`.
"""

import json
import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import replacing

_STALE = 1.0  # [s]
_NANO = 1e-9
FORMAT = "%.9g"  # of numbers in a table
_WANTED = re.compile(r"(\w+)=(/?[\w/]+)((?:\.\w+|\[\d+\])+)(?::(\w+))?")
_STEP = re.compile(r"\.(\w+)|\[(\d+)\]")
_UNITS = {  # of quantities that are not pressures
    **dict.fromkeys(("theta", "q"), "rad"),
    **dict.fromkeys(("speed", "v"), "rad_s"),
    **dict.fromkeys(("length", "shortening", "rest_length"), "m"),
    **dict.fromkeys(("direction", "slack"), ""),
    "force": "N",
    "torque": "Nm",
    "contraction": "ratio",
}
_RECORDINGS = (".bag", ".mcap")
_MOST_SHOWN = 12
_USAGE = "the unit where it is not SI, several with blanks between them"
_NO_NUMBER = LookupError, AttributeError, TypeError, ValueError


class Quantity(NamedTuple):
    """A number in the messages of a topic."""

    name: str
    topic: str
    path: tuple[str | int, ...]  # fields and indices
    unit: str

    @classmethod
    def parse(cls, text: str) -> tuple["Quantity", ...]:
        """Return the quantities of a text like ``theta=/joint_states.position[0] pressure1=/p1.data:bar``.

        Raises `InvalidInput`.
        """
        found = []
        for part in text.split():
            if (match := _WANTED.fullmatch(part)) is None:
                raise InvalidInput(f"--topics {part}: expected NAME=/topic.field[0]:unit, {_USAGE}")
            name, topic, path, unit = match.groups()
            steps = tuple(field or int(index) for field, index in _STEP.findall(path))
            found.append(cls(name, topic, steps, unit or _UNITS.get(name.rstrip("0123456789"), "Pa")))
        if len({q.name for q in found}) < len(found):
            raise InvalidInput(f"--topics {text}: a quantity is given twice")
        if not found:
            raise InvalidInput(f"--topics is empty: NAME=/topic.field[0]:unit, {_USAGE}")
        return tuple(found)

    def of(self, message: object) -> float:
        """Return the number, NaN if the message has none."""
        try:
            for step in self.path:
                message = _inside(message, step)
            return float(message)  # type: ignore[arg-type]
        except _NO_NUMBER:
            return float("nan")

    def without(self, message: object) -> str:
        """Return the part of a message in which the path ends without a number, in words."""
        place, rest = self.topic, iter(self.path)
        for step in rest:
            try:
                message = _inside(message, step)
            except _NO_NUMBER:
                break
            place += f"[{step}]" if isinstance(step, int) else f".{step}"
        return f"{place} has {_shape(message)}"


def _inside(message: Any, step: str | int) -> object:
    """Return a field or an element. Raises one of `_NO_NUMBER` if there is none."""
    return message[step] if isinstance(step, int) or isinstance(message, dict) else getattr(message, step)


class Bag(NamedTuple):
    """An open recording."""

    topics: dict[str, tuple[str, int]]  # type and number of the messages
    messages: Callable[[Sequence[str]], Iterator[tuple[str, int, object]]]  # of topics: topic, time [ns], message


def is_recording(path: Path) -> bool:
    """Return whether this is a recording by its name, or the folder of a ROS 2 bag."""
    return path.suffix in _RECORDINGS or (path / "metadata.yaml").exists()


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """Open a recording: a .bag, a .mcap, or the folder of a ROS 2 bag. Raises `InvalidFile` for anything else."""
    if not path.exists():
        raise InvalidFile(path, "does not exist")
    if path.is_dir() and not is_recording(path):
        raise InvalidFile(path, "is a folder without metadata.yaml: it is no ROS 2 bag")
    if path.suffix == ".mcap":
        with _mcap(path) as bag:
            yield bag
        return
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            topics = {name: (str(info.msgtype), info.msgcount) for name, info in reader.topics.items()}

            def messages(wanted: Sequence[str]) -> Iterator[tuple[str, int, object]]:
                connections = [c for c in reader.connections if c.topic in wanted]
                for connection, time, raw in reader.messages(connections=connections):
                    yield connection.topic, time, reader.deserialize(raw, connection.msgtype)

            yield Bag(topics, messages)
    except AnyReaderError as error:
        raise InvalidFile(path, f"is no ROS bag that can be read ({' '.join(str(error).split())})") from None


@contextmanager
def _mcap(path: Path) -> Iterator[Bag]:
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with path.open("rb") as stream:
            reader = make_reader(stream)
            if (summary := reader.get_summary()) is None:
                raise InvalidFile(path, "has no summary: it was not closed; `mcap recover` repairs it")
            counts = summary.statistics.channel_message_counts if summary.statistics else {}
            topics = {
                channel.topic: (
                    summary.schemas[channel.schema_id].name if channel.schema_id else "no schema",
                    counts.get(number, 0),
                )
                for number, channel in summary.channels.items()
            }
            decode = _Decoder(path)

            def messages(wanted: Sequence[str]) -> Iterator[tuple[str, int, object]]:
                for schema, channel, message in reader.iter_messages(topics=wanted):
                    yield channel.topic, message.log_time, decode(channel.message_encoding, schema, message.data)

            yield Bag(topics, messages)
    except McapError as error:
        what = f"is no MCAP file that can be read ({str(error) or 'it ends too early'})"
        raise InvalidFile(path, f"{what}; `mcap recover` repairs a broken one") from None


class _Decoder:
    """Messages of an MCAP file from their bytes: JSON, or ROS 1 and 2 by the definitions in the file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[str, Callable[[bytes], object]] = {}

    def __call__(self, encoding: str, schema: Any, data: bytes) -> object:
        if encoding == "json":
            return json.loads(data)
        if encoding not in ("cdr", "ros1") or schema is None:
            raise InvalidFile(self._path, f"messages are encoded as {encoding!r}: json, cdr and ros1 can be read")
        if schema.name not in self._known:
            self._known[schema.name] = self._typed(encoding, schema.name, schema.data.decode())
        return self._known[schema.name](data)

    def _typed(self, encoding: str, name: str, definition: str) -> Callable[[bytes], object]:
        from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

        typed = name if "/msg/" in name else name.replace("/", "/msg/")
        store = get_typestore(Stores.EMPTY)
        try:
            store.register(get_types_from_msg(definition, typed))
        except TypesysError as error:
            raise InvalidFile(self._path, f"type {name} cannot be read ({error})") from None
        if encoding == "cdr":
            return lambda data: store.deserialize_cdr(data, typed)
        return lambda data: store.deserialize_ros1(data, typed)


def read_topics(path: Path, quantities: Sequence[Quantity]) -> dict[str, tuple[Array, Array]]:
    """Return times (n,) [s] and numbers (n,) of each quantity by its name; NaN of a message without the number.

    Raises `InvalidFile` for an unknown topic, with the existing ones, and for one that never has the number.
    """
    series = {q.name: (array("q"), array("d")) for q in quantities}
    last: dict[str, object] = {}  # message of each topic
    with opened(path) as bag:
        for q in quantities:
            if q.topic not in bag.topics or not bag.topics[q.topic][1]:
                what = "has no messages" if q.topic in bag.topics else "is not in it"
                raise InvalidFile(path, f"topic {q.topic} {what}; topics: {described(bag)}")
        for topic, time, message in bag.messages([q.topic for q in quantities]):
            last[topic] = message
            for q in quantities:
                if q.topic == topic:
                    times, values = series[q.name]
                    times.append(time)
                    values.append(q.of(message))
    for q in quantities:
        if np.isnan(series[q.name][1]).all():
            raise InvalidFile(path, f"{q.name}: no message has a number there; {q.without(last[q.topic])}")
    begin = min(times[0] for times, _ in series.values())
    return {
        name: (np.asarray((np.frombuffer(times, np.int64) - begin) * _NANO), np.array(values, float))
        for name, (times, values) in series.items()
    }


def described(bag: Bag) -> str:
    """Return the topics of a bag with types and numbers of messages."""
    told = [f"{name} ({kind}, {count})" for name, (kind, count) in sorted(bag.topics.items())]
    more = f" and {len(told) - _MOST_SHOWN} more" if len(told) > _MOST_SHOWN else ""
    return (", ".join(told[:_MOST_SHOWN]) or "none") + more


def _shape(message: object) -> str:
    if isinstance(message, np.ndarray | list):
        return f"length {len(message)}"
    fields = message if isinstance(message, dict) else getattr(message, "__dict__", {})
    return ", ".join(name for name in fields if not name.startswith("__")) or "no fields"


def to_csv(path: Path, quantities: Sequence[Quantity], out: Path) -> tuple[int, int]:
    """Write the quantities of a recording as a CSV, and return the numbers of rows written and left out.

    Raises `InvalidFile` as `read_topics` does, and `CannotWrite`.
    """
    names, table, left = sampled(path, quantities)
    with replacing(out) as draft:
        np.savetxt(draft, table, fmt=FORMAT, delimiter=",", header=",".join(names), comments="")
    return len(table), left


def sampled(path: Path, quantities: Sequence[Quantity]) -> tuple[list[str], Array, int]:
    """Return (names with units, values (n, 1 + quantities), times first, number of rows left out).

    Raises `InvalidFile` as `read_topics` does.
    """
    series = read_topics(path, quantities)
    t, _ = series[quantities[0].name]
    order = np.argsort(t, kind="stable")
    t = t[order]
    columns, known = [], np.ones(t.size, bool)
    for q in quantities:
        times, values = series[q.name]
        sort = np.argsort(times, kind="stable")
        at = np.searchsorted(times[sort], t, side="right") - 1
        known &= (at >= 0) & (t - times[sort][at] <= _STALE)
        columns.append(values[sort][at])
    names = ["time [s]", *(f"{q.name} [{q.unit}]" if q.unit else q.name for q in quantities)]
    return names, np.stack([t, *columns], axis=1)[known], int((~known).sum())
