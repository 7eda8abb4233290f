"""Certificate of an exported QP: greatest numbers of sweeps and multiplications, and bytes of the stack.

The numbers of operations hold for any input: they are counted along the dearest paths through the printed functions,
with the greatest numbers of turns of their loops. The bound of the stack is fitted to a compiler's measurement.
"""

import ast
from collections.abc import Mapping, Sequence
from functools import cache
from math import inf
from typing import Any, NamedTuple

from allocator.compilation.jit import Function
from allocator.compilation.printer import ArrayKind, Kind, StructKind, parsed, with_called
from mpc.export.controller.recursions import exchanges_in, items_in, kinds_of, solver_of
from mpc.model.arm.compiled.module import moving
from mpc.model.arm.model import Arm
from mpc.tracking.compiled.structured_qp.barrier import TURNS
from mpc.tracking.compiled.structured_qp.exchange import AGAIN
from mpc.tracking.compiled.structured_qp.sizes import limit_lines, spare
from mpc.tracking.compiled.structured_qp.solve import SEARCHES
from mpc.tracking.controller import TrackingMPC

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
    sizes["MOVING"] = moving(plant) if isinstance(plant, Arm) else plant.size
    sizes["ITEMS"] = items_in(plant.n, plant.m, blocks, single)
    # greatest values of the names that bound the solver's loops
    most = {"N": N, "last": N, "size": sizes["ITEMS"] - 1, "known": 0, "first_line": 0, "left": plant.m}
    most |= {"lines": limit_lines(plant.n, plant.m), "named": max(2, sizes["ITEMS"] - spare(plant.n, plant.m))}
    most |= {f"ANT_{name}": size for name, size in sizes.items()}
    functions, kinds, exchanges = with_called(solver_of(plant)), kinds_of(plant), exchanges_in(plant.m * blocks)
    begin, exchange = _Count(functions, kinds, most).of_qp()
    _, plain = _Count(functions, kinds, most, {"rebased": 0}).of_qp()
    filled = isinstance(plant, Arm) and plant.gas is not None
    stack = _stack(plant.n, plant.m, N + blocks, filled) * (4 if single else 8) + _FRAMES
    return Certificate(exchanges, SEARCHES + (SEARCHES - 1) * TURNS + exchanges, begin, exchange, plain, stack)


def _stack(n: int, m: int, commands: int, filled: bool) -> int:
    """Return the numbers on the stack in the deeper of two chains of calls, to a sweep of the QP or to a prediction of
    the observer.

    Their arrays are plans and a cost-to-go, or covariances and Jacobians, of an arm `filled` with gas also those of its
    pressures and their rates.
    """
    xi, beliefs = 2 * (n + m), 3 * n + m
    pressures = m * (4 * (1 + xi + n) + 2 * n + m) * filled
    return _NUMBERS + max(m * commands + 2 * xi**2 + 4 * xi, 6 * beliefs**2 + 5 * n * xi + pressures)


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
        return int(begin + SEARCHES * AGAIN * max(again - exchange, 0)), int(exchange)

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
            # the search of `solve` without a barrier is left out: of the interruptions counted instead, one is possible
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
