"""QP solver of a step as C (`recursions.h`, `recursions.c`), printed from the Python source that runs in Python.

Certificate of an exported QP: greatest numbers of sweeps and multiplications, and bytes of the stack.

The numbers of operations hold for any input: they are counted along the dearest paths through the printed functions,
with the greatest numbers of turns of their loops. The bound of the stack is fitted to a compiler's measurement.
"""

import ast
from collections.abc import Mapping, Sequence
from functools import cache
from math import inf
from typing import Any, NamedTuple

from allocator.compilation.jit import Function
from allocator.compilation.printer import INT, REAL, ArrayKind, Kind, StructKind, c_functions, parsed, with_called
from mpc.export import text
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine
from mpc.tracking.compiled.structured_qp.barrier import TURNS
from mpc.tracking.compiled.structured_qp.exchange import AGAIN
from mpc.tracking.compiled.structured_qp.sizes import limit_lines, spare
from mpc.tracking.controller import TrackingMPC

_N, _AFTER, _BLOCKS = "ANT_HORIZON", "ANT_HORIZON + 1", "ANT_BLOCKS"
_M, _X, _XI, _Y = "ANT_MUSCLES", "ANT_STATES", "ANT_XI", "ANT_OUTPUTS"
_SIDE = "signed char"
_SINGLE = {"PUSHES": 0.5, "BREAKS": 1e-6, "ROW_BREAKS": 1e-5, "FLAT": 1e-5}  # rounding tolerances of float32
_ITEMS = {True: 28, False: 16}  # by single precision; more would not fit into a microcontroller


def recursion_files(plant: Machine, single: bool) -> dict[str, str]:
    """Return the files of the solver, which are the same for every joint; sizes stand in antagonist_config.h."""
    return _printed(tuple(solver_of(plant)), isinstance(plant, Arm), single)


@cache
def _printed(entries: tuple[Function, ...], arm: bool, single: bool) -> dict[str, str]:
    structs = _structs(arm)
    names = {entry.__name__: f"ant_{entry.__name__}" for entry in entries} | {"solve": "ant_settle"}
    made = c_functions(with_called(entries), _kinds(structs), single, names, _SINGLE if single else {})
    about = "The QP of a step, solved sample by sample; printed from the Python source."
    head = "\n\n".join([*(struct.definition() for struct in structs.values()), made.head])
    body = "\n\n".join([f'/* {about} */\n#include "recursions.h"\n\n#include "real.h"', made.body])
    return {
        "src/recursions.h": text.header("ANT_RECURSIONS_H", about, head, ["antagonist.h"]),
        "src/recursions.c": f"{body}\n",
    }


def solver_of(plant: Machine) -> list[Function]:
    """Return the exported functions of the solver, for the sizes of an arm."""
    if isinstance(plant, Arm):
        from mpc.tracking.compiled.arm.module import solve_module

        module = solve_module(plant)
        return [getattr(module, name) for name in ("limit", "excess", "change_bounds", "deviations", "solve")]
    from mpc.tracking.compiled import commands
    from mpc.tracking.compiled.structured_qp import solve

    return [commands.limit, commands.excess, commands.change_bounds, commands.deviations, solve.solve]


def kinds_of(plant: Machine) -> Mapping[str, Kind]:
    """Return the kinds of the solver's arguments, by their names in all functions."""
    return _kinds(_structs(isinstance(plant, Arm)))


def items_in(n: int, m: int, blocks: int, single: bool) -> int:
    """Return the maximum number of items in an exchange of active bounds (`structured_qp.responses`)."""
    from mpc.tracking.compiled.structured_qp.sizes import spare

    return min(m * blocks + spare(n, m), _ITEMS[single])


def exchanges_in(changes: int) -> int:
    """Return the maximum number of exchanges in a QP."""
    from mpc.tracking.compiled.structured_qp.solve import MOST

    return MOST * changes


def _array(*sizes: str | int, element: str = REAL, constant: bool = False) -> ArrayKind:
    return ArrayKind(element, tuple(map(str, sizes)), constant)


def _given(*sizes: str | int, element: str = REAL) -> ArrayKind:
    return _array(*sizes, element=element, constant=True)


def _structs(arm: bool) -> dict[str, StructKind]:
    """Return the C structs of the named tuples, each after the structs that it contains."""
    made: dict[str, StructKind] = {}
    parts: dict[type, Kind] = {}
    for name, (record, constant) in _records().items():
        struct = StructKind.of(record, f"ant_qp_{name}", _SIZES, constant=constant, parts=parts)
        own = _OF_ARMS.get(name, {}) if arm else {}
        made[name] = parts[record] = struct._replace(fields={**struct.fields, **own})
    fields = {**made["setting"].fields, "starts": _given(_BLOCKS, element=INT)}
    return made | {"setting": made["setting"]._replace(fields=fields)}


def _records() -> dict[str, tuple[type, bool]]:
    """Return the named tuples by name, and whether their arrays are only read."""
    from mpc.tracking.compiled.records import Bounded, Bounds, Cost, Errors, Path, Point, Reference, Setting
    from mpc.tracking.compiled.structured_qp.active import Active
    from mpc.tracking.compiled.structured_qp.responses import Items
    from mpc.tracking.compiled.structured_qp.riccati import Sweep

    read = {"cost": Cost, "bounds": Bounds, "path": Path, "reference": Reference}
    filled = {"errors": Errors, "point": Point, "bounded": Bounded, "sweep": Sweep, "items": Items, "active": Active}
    groups = ((read, True), (filled, False), ({"setting": Setting}, True))
    return {name: (record, constant) for records, constant in groups for name, record in records.items()}


_SIZES = {"N": _N, "M": "ANT_ITEMS", "n": "ANT_JOINTS", "m": _M, "x": _X, "xi": _XI, "y": _Y}
_OF_ARMS: dict[str, dict[str, Kind]] = {
    "bounds": dict.fromkeys(("left", "right"), _given("ANT_JOINTS")),
    "path": {"A": _given(_N, "2 * ANT_JOINTS", _XI), "B": _given(_M)},
    "sweep": dict.fromkeys(("D", "inverse"), _array(_N, _M, _M)),
}


def _kinds(structs: dict[str, StructKind]) -> dict[str, Kind]:
    """Return the kinds of arguments, by their names in all functions."""
    sweep, items = structs["sweep"].fields, structs["items"].fields
    return {
        **structs,
        **{name: structs["path"].fields[name] for name in ("A", "B", "slope")},
        **{name: sweep[name] for name in ("R", "D", "g", "feedback", "held", "gx", "gv", "inverse")},
        **{"at": structs["point"], "a": structs["active"], "base": sweep["held"], "v": sweep["gv"]},
        **{"xi": sweep["xi"], **dict.fromkeys(("r", "first"), structs["active"].fields["r"])},
        **{"S": _array(_XI, _XI), "SA": _array(_XI, _XI), "F": sweep["feedback"]},
        **{"s": _array(_XI), "p": _array(_XI), "slack": _given(4), "last": _given(2, _M)},
        **dict.fromkeys(("e", "charge", "charges"), sweep["e"]),
        "before": _given(_M),
        **{"u": _given(_N, _M), "guess": _array(f"{_M} * {_BLOCKS}", element=_SIDE)},
        **{"z": items["z"], "pushes": items["r"]},
        **{"commands": sweep["gv"], "states": _given(_AFTER, _X), "forces": _given(_AFTER, _M), "beyond": _array(2)},
        "starts": _given(_BLOCKS, element=INT),
        "free": _array(_M, element=_SIDE),
        **dict.fromkeys(("left", "right", "limits"), structs["bounds"].fields["left"]),
    }


COMPILER = "arm-none-eabi-gcc 12.2"  # whose stack was measured
_FRAMES, _NUMBERS = 576, 150  # bytes of frames and saved registers, and single numbers, in the deepest chain of calls


class Certificate(NamedTuple):
    """Bounds of a QP, and of the stack of a step; multiplications include divisions."""

    exchanges: int
    sweeps: int
    begin: int  # multiplications without exchanges, with the proof
    exchange: int  # of an exchange that needs a new sweep
    plain: int  # of one that needs none
    stack: int  # bytes


def certificate(controller: TrackingMPC, single: bool) -> Certificate:
    """Return the bounds for the exported `controller`."""
    plant, N, blocks = controller.plant, controller.N, len(controller.problem.blocks)
    sizes = {"JOINTS": plant.n, "MUSCLES": plant.m, "STIFFNESSES": plant.stiffnesses, "BLOCKS": blocks, "HORIZON": N}
    sizes |= {"STATES": 2 * plant.n + plant.m, "XI": 2 * plant.n + 2 * plant.m, "OUTPUTS": plant.stiffnesses + plant.m}
    sizes["ITEMS"] = items_in(plant.n, plant.m, blocks, single)
    # greatest values of the names that bound the solver's loops
    most = {"N": N, "last": N, "size": sizes["ITEMS"] - 1, "known": 0, "left": plant.m}
    most |= {"lines": limit_lines(plant.n, plant.m), "named": max(2, sizes["ITEMS"] - spare(plant.n, plant.m))}
    most |= {f"ANT_{name}": size for name, size in sizes.items()}
    functions, kinds, exchanges = with_called(solver_of(plant)), kinds_of(plant), exchanges_in(plant.m * blocks)
    begin, exchange = _Count(functions, kinds, most).of_qp()
    _, plain = _Count(functions, kinds, most, {"rebased": 0}).of_qp()
    stack = _stack(plant.n, plant.m, N + blocks, 4 if single else 8)
    return Certificate(exchanges, 2 + TURNS + exchanges, begin, exchange, plain, stack)


def _stack(n: int, m: int, commands: int, number: int) -> int:
    """Return bytes for the deeper of two chains of calls: down to a sweep of the QP, or to the observer's prediction.

    Their arrays are plans and a cost-to-go, or covariances and Jacobians.
    """
    xi, beliefs = 2 * (n + m), 3 * n + m
    return _FRAMES + number * (_NUMBERS + max(m * commands + 2 * xi**2 + 4 * xi, 6 * beliefs**2 + 5 * n * xi))


class _Count:
    """Count of operations, given the greatest values of names that bound loops.

    `known` has the counts of functions already counted.
    """

    def __init__(
        self,
        functions: Sequence[Function],
        kinds: Mapping[str, Kind],
        most: Mapping[str, int],
        known: Mapping[str, int] | None = None,
    ) -> None:
        self.nodes = {node.name: node for node in map(parsed, functions)}
        self.kinds, self.most, self.counts = kinds, most, dict(known or {})
        self.names: dict[str, Any] = {}  # global ones, sizes among them
        for function in functions:
            self.names |= getattr(function, "py_func", function).__globals__
        self.operations = cache(self._operations)
        self.turn = 0.0, 0.0  # of the loop of exchanges: of a turn to its end, and of one that leaves it before

    def of_qp(self) -> tuple[int, int]:
        """Return the numbers of a QP without exchanges, and of an exchange."""
        begin = sum(map(self.of, ("deviations", "change_bounds", "solve")))
        again, exchange = self.turn  # a turn reaches its end if an answer has no proof
        return int(begin + 2 * AGAIN * max(again - exchange, 0)), int(exchange)

    def of(self, name: str) -> int:
        """Return the greatest number of a function."""
        if name not in self.counts:
            self.counts[name] = int(max(self.block(self.nodes[name].body, {})))
        return self.counts[name]

    def block(self, body: Sequence[ast.stmt], at: dict[str, int]) -> tuple[float, float]:
        """Return the greatest numbers along paths to the end of `body`, and along those that leave it before."""
        through, left = 0.0, 0.0
        for node in body:
            match node:
                case ast.If(test, yes, no):
                    through += self.operations(test)
                    ends, leaves = zip(self.block(yes, at), self.block(no, at), strict=True)
                    left, through = max(left, through + max(leaves)), through + max(ends)
                case ast.For(ast.Name("step"), _, turn, _):
                    self.turn = self.block(turn, at)
                case ast.For(ast.Name(name), sequence, turn, _):
                    values = self.values(sequence, at)
                    each = values if _bounds_a_loop(node, name) else values[:1]
                    counts = [max(self.block(turn, at | {name: i})) for i in each]
                    through += sum(counts) * len(values) / max(len(each), 1)
                case ast.While(ast.Name(name), turn, _):
                    through += self.most[name] * max(self.block(turn, at))
                case ast.Continue() | ast.Break() | ast.Return():
                    return -inf, max(left, through + self.operations(node))
                case _:
                    through += self.operations(node)
        return through, left

    def _operations(self, node: ast.AST) -> int:
        """Return the number of an expression or a simple statement; indices do not count."""
        match node:
            case ast.Subscript(array, _):
                return self.operations(array)
            case ast.IfExp(test, yes, no):
                return self.operations(test) + max(self.operations(yes), self.operations(no))
        own = isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Mult | ast.Div)
        called = node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""
        inner = self.of(called) if called in self.nodes else 0
        return own + inner + sum(map(self.operations, ast.iter_child_nodes(node)))

    def values(self, sequence: ast.expr, at: dict[str, int]) -> range:
        """Return the values of a loop's variable."""
        if isinstance(sequence, ast.Call):
            return range(*(self.value(bound, at) for bound in sequence.args))
        return range(self.sizes(sequence)[0])

    def value(self, node: ast.expr, at: dict[str, int]) -> int:
        """Return the greatest value of an integer."""
        match node:
            case ast.Constant(int() as value):
                return value
            case ast.Name(name):
                return int(at[name] if name in at else self.most[name] if name in self.most else self.names[name])
            case ast.UnaryOp(ast.USub(), operand):
                return -self.value(operand, at)
            case ast.BinOp(left, op, right):
                one, other = self.value(left, at), self.value(right, at)
                return one * other if isinstance(op, ast.Mult) else one + other * (1 if isinstance(op, ast.Add) else -1)
            case ast.IfExp(_, yes, no):
                return max(self.value(yes, at), self.value(no, at))
            case ast.Attribute(array, "size") | ast.Subscript(ast.Attribute(array, "shape"), ast.Constant(0)):
                return self.sizes(array)[0]
            case ast.Subscript(ast.Attribute(array, "shape"), ast.Constant(1)):
                return self.sizes(array)[1]
        return self.most["size"]  # the number of known lines of the factor

    def sizes(self, array: ast.expr) -> tuple[int, ...]:
        """Return the sizes of an array."""
        kind = self.kind(array)
        listed = kind.sizes if isinstance(kind, ArrayKind) else ()
        return tuple(self.value(ast.parse(size, mode="eval").body, {}) for size in listed)

    def kind(self, node: ast.expr) -> Kind:
        """Return the kind of a field, of an argument, or of a variable with the name of a field."""
        if isinstance(node, ast.Attribute):
            struct = self.kind(node.value)
            return struct.fields[node.attr] if isinstance(struct, StructKind) else ""
        name = node.id if isinstance(node, ast.Name) else ""
        fields = (kind.fields for kind in self.kinds.values() if isinstance(kind, StructKind))
        return self.kinds[name] if name in self.kinds else next(each[name] for each in fields if name in each)


@cache
def _bounds_a_loop(node: ast.For, name: str) -> bool:
    """Return whether a loop within `node` depends on the variable `name`."""
    loops = (inner.iter for inner in ast.walk(node) if isinstance(inner, ast.For) and inner is not node)
    return any(isinstance(part, ast.Name) and part.id == name for loop in loops for part in ast.walk(loop))
