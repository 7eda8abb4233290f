"""The README of the exported files."""

from allocator.joint import AntagonistJoint

_TEXT = """\
# A pneumatic-muscle joint in C

Exported from the Python package `antagonist`, in {precision} precision, for: {joint}.
Plain C99; no heap, no dependency but `math.h`, every loop bounded; `antagonist.h` is the one header to read. SI units.

    cmake -S . -B build && cmake --build build && build/demonstration

or

    cc -O2 -std=c99 -I. -Isrc {includes}main.c src/*.c {sources}-lm -o demonstration

which prints, according to Python{rounded}:

```text
{printed}
```

## Allocation

`ant_allocate` gives the pressures for a torque and a stiffness at an angle: the global optimum in closed form, as
`allocator.allocate(..., method="exact")` does. {cost} What makes no sense (NaN, K <= 0, an angle beyond a turn) is
answered by `ANT_BAD_INPUT` and pressures within the supply.
"""

_COST = {
    "tondu": "A call costs at most 9 square roots and divisions by the dozen, 4 Newton steps, no other loop.",
    "affine": "A call costs one evaluation of the joint's formulas (`src/model.c`) and some dozen operations, no loop.",
}


def readme(joint: AntagonistJoint, law: str, single: bool, printed: list[str]) -> str:
    """Its text; `printed` is what the demonstration prints according to Python."""
    muscles = " and ".join(type(muscle).__name__ for muscle in (joint.agonist, joint.antagonist))
    return _TEXT.format(
        precision="single" if single else "double",
        joint=f"{muscles} on a {type(joint.geometry).__name__}",
        includes="",
        sources="",
        rounded=" (single precision differs in the last digits)" if single else "",
        printed="\n".join(printed),
        cost=_COST[law],
    )


__all__ = ["readme"]
