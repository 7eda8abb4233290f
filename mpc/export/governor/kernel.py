"""The kernel of governors as C is printed from the text that Python and numba run: `kernel.h` and `kernel.c`."""

import re

import numpy as np

from allocator.compilation.printer import INT, MIN_AND_MAX, REAL, ArrayKind, Kind, StructKind, c_functions
from mpc.export import text
from mpc.governor import kernel

_N, _M = "ANT_JOINTS", "ANT_MUSCLES"
_JOINTS = "load", "angles", "rates", "guess", "alpha", "later"
_SIZES: dict[str, tuple[str, ...]] = {
    "numbers": ("10",),
    "ends": (_N, "2"),
    "within": (_N, "2"),
    "steps": ("2",),
    "strong": ("2", _M),
    "scenes": ("ANT_SCENES", "ANT_SCENE"),
    "barrier": ("ANT_SCENES", "2"),
    "weight": ("ANT_SCENES", _M),
    "lag": ("ANT_SCENES", _M),
    "decay": ("2 * ANT_SCENES", _M),
    "counts": ("5",),
    "scene": ("ANT_SCENE",),
    "motion": ("1",),  # the formulas have their numbers in them
    "potential": ("1",),
    "energy": ("2",),
    "level": ("1",),
    **dict.fromkeys(_JOINTS, (_N,)),
}

_FORMULAS = """\
/* The formulas, which have their numbers in them. */
static void motion(const ant_real *q, const ant_real *omega, const ant_real *P, const ant_real *scene,
                   const ant_real *c, ant_real *alpha, ant_real *gain, ant_real *force, ant_real *speed,
                   ant_real *energy) {
    (void)c;
    ant_model_motion(q, omega, P, scene, alpha, gain, force, speed, energy);
}

static void potential(const ant_real *q, const ant_real *scene, const ant_real *c, ant_real *level) {
    (void)c;
    ant_model_potential(q, scene, level);
}
"""


def motion(q, omega, P, scene, c, alpha, gain, force, speed, energy):  # type: ignore[no-untyped-def]
    """Stand in for the formula, which C calls by `_FORMULAS`."""


def potential(q, scene, c, level):  # type: ignore[no-untyped-def]
    """Stand in for the formula, which C calls by `_FORMULAS`."""


def kernel_files(single: bool) -> dict[str, str]:
    """Return the files of the kernel, which are the same for every mechanism; sizes stand in antagonist_config.h."""
    rules = StructKind("ant_rules", {name: _array(name, True) for name in kernel.Rules._fields}, False)
    memory = StructKind("ant_memory", {name: _array(name) for name in kernel.Memory._fields}, True)
    functions = (motion, potential, *kernel.FUNCTIONS)
    made = c_functions(functions, _kinds(rules, memory), single, {"govern": "ant_kernel_govern"}, {})
    body, stubs = re.subn(r"(?:/\*[^*]*\*/\n)?static void (?:motion|potential)\([^;{]*\{\n[^}]*\}\n\n", "", made.body)
    assert stubs == 2
    about = "A governor's kernel, printed from Python's text of it."
    includes = '#include "kernel.h"\n\n#include "model.h"\n#include "real.h"'
    return {
        "antagonist_memory.h": text.header("ANTAGONIST_MEMORY_H", _WORKS, memory.definition(), ["antagonist.h"]),
        "src/kernel.h": text.header(
            "ANT_KERNEL_H", about, f"{rules.definition()}\n\n{made.head}", ["antagonist_memory.h"]
        ),
        "src/kernel.c": "\n\n".join([f"/* {about} */\n{includes}", MIN_AND_MAX, _FORMULAS, body]) + "\n",
    }


_WORKS = "What ant_govern works in: one for each thread, best made static."


def _array(name: str, constant: bool = False) -> ArrayKind:
    return ArrayKind(INT if name == "counts" else REAL, _SIZES.get(name, (_M,)), constant)


def _kinds(rules: StructKind, memory: StructKind) -> dict[str, Kind]:
    """Return what arguments are, by their names in all functions."""
    given = {name: ArrayKind(REAL, (_M,), True) for name in ("P", "previous", "command")}
    given["scene"] = ArrayKind(REAL, _SIZES["scene"], True)
    made = {name: memory.fields[name] for name in ("alpha", "gain", "force", "speed", "energy", "level")}
    ends = {"q": ArrayKind(REAL, (_N,), True), "omega": ArrayKind(REAL, (_N,), True), "safe": ArrayKind(REAL, (_M,))}
    return {"rules": rules, "memory": memory, **given, **made, **ends, "c": ArrayKind(REAL, ("1",), True), "mu": REAL}


def numbers_file(rules: kernel.Rules, single: bool) -> str:
    """Return the header with the numbers of a governor."""
    none = np.zeros(1)
    tables = rules._replace(motion=none, potential=none)._asdict()
    body = [f"static {text.table(f'ANT_RULES_{name.upper()}', values, single)}" for name, values in tables.items()]
    listed = ", ".join(f"ANT_RULES_{name.upper()}" for name in tables)
    body.append(f"static const ant_rules ANT_RULES = {{{listed}}};")
    about = "The governor's numbers, in SI units; mpc/governor/kernel.py says what they are."
    return text.header("ANT_GOVERNOR_H", about, "\n\n".join(body), ["kernel.h", "real.h"])
