"""The header protocol.h of the firmware is printed from the tables of `mpc.bench.devices.serial_protocol`."""

from collections.abc import Iterable
from enum import IntEnum

from mpc.bench.devices import serial_protocol as protocol
from mpc.bench.devices.serial_protocol import Field
from mpc.export import text


def protocol_header() -> str:
    """Return protocol.h: constants, and where the fields of every frame lie."""
    parts = [
        _defines("version and sizes [bytes, samples]", _sizes()),
        *(_enumerated(kind) for kind in (protocol.Kind, protocol.State, protocol.Refusal)),
        _layout("HEADER", protocol.HEADER),
        *(_layout(kind.name, fields) for kind, fields in protocol.LAYOUTS.items()),
        _layout("SAMPLE", protocol.SAMPLE),
    ]
    about = "The line protocol, printed from the tables that the host runs by. Offsets count from a body's begin."
    return text.header("ANT_PROTOCOL_H", about, "\n".join(parts))


def _sizes() -> dict[str, int]:
    return {
        "PROTOCOL": protocol.VERSION,
        "LONGEST": protocol.LONGEST,
        "CRC_BYTES": protocol.CRC_BYTES,
        "BATCH": protocol.BATCH,
    }


def _defines(about: str, values: dict[str, int]) -> str:
    return f"/* {about} */\n" + "".join(f"#define ANT_{name} {value}\n" for name, value in values.items())


def _enumerated(kind: type[IntEnum]) -> str:
    """Return a C enumeration; its first lines of documentation are Python's."""
    about = (kind.__doc__ or "").splitlines()[0]
    name = kind.__name__
    members = ",\n".join(f"    ANT_{name.upper()}_{member.name} = {member.value}" for member in kind)
    return f"/* {about} */\ntypedef enum {{\n{members}\n}} ant_{name.lower()};\n"


def _layout(name: str, fields: Iterable[Field]) -> str:
    """Return where `fields` lie, and how many bytes they are."""
    lines, at = [], 0
    for field in fields:
        lines.append(f"    ANT_{name}_{field.name.upper()} = {at}, /* {field.type}, {field.meaning} */")
        at += protocol.packing((field,)).size
    lines.append(f"    ANT_{name}_BYTES = {at}")
    return "enum {\n" + "\n".join(lines) + "\n};\n"
