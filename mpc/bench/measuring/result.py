"""Result of a measurement: strengths, backbone K, felt K by amplitude, loss and damping, or the reason of a refusal.

Every stiffness is that of motions at the tones' frequencies. Creep that is slower than they are counts as stiffness, of
which a push that lasts for many seconds meets nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import hypot, isfinite, nan, sqrt
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from allocator.calculus import Array
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.felt import Loop
from allocator.presentation.plotting import legend_below, new_figure
from allocator.units import BAR, DEG
from mpc.bench.measuring.driving import Findings
from mpc.bench.measuring.loops import Tone
from mpc.bench.measuring.springs import SPRINGS, backbone, secant
from mpc.bench.measuring.strengths import (
    LOSSY,
    WIDER,
    Known,
    Load,
    Solution,
    solve,
    why_implausible,
    why_not,
    why_rubber,
)
from mpc.bench.measuring.weighing import Scale, disagreement, scale_of, weighed
from mpc.model.plant import Plant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAST_STEPS = 4.0  # of the encoder in a swing
_SCATTER = 0.02  # [-] of K_felt: waveform of the turns, beyond the errors of phasors (seeds >= 1000)
_BALANCED = 0.025  # [-] of a muscle's torque: offsets of sensors, muscle model
_CENTRED = 0.25  # of the height of a loop: how well it is centred
_SHAPE = 0.06  # [-] of the backbone K: the force law's shape, by strangers (seeds 1000-1015)
_CABLES = 0.04  # [-] of the strengths per K_felt/K - 1: stuck hysteresis stretches cables, by the same strangers
_SCALE_KNOWN = 0.25  # greatest useful standard deviation of the scale by a weight
_NORMAL = 1.96  # of 95 %


class Felt(NamedTuple):
    """Felt stiffness at one amplitude."""

    amplitude: float  # A [rad]
    K: float  # secant [N·m/rad], at held pressures
    K_std: float
    loss: float  # loss factor η [-]
    model: float  # K_felt(A) by the previous model [N·m/rad]


@dataclass(frozen=True)
class MeasuredStiffness:
    """Stiffness measured about one rest."""

    theta: float  # [rad]
    pressures: tuple[float, float]  # [Pa]
    strengths: tuple[float, float] = (nan, nan)  # g_i [-], relative to the model's
    covariance: Array = field(default_factory=lambda: np.full((2, 2), nan))  # of the strengths (2, 2) [-]
    K: float = nan  # backbone [N·m/rad]: that of the model with these strengths and of the loops, averaged; or by a log
    K_std: float = nan
    model_K: float = nan  # backbone by the previous model [N·m/rad]
    felt: tuple[Felt, ...] = ()
    damping: float = nan  # D [N·m·s/rad]
    damping_std: float = nan
    age: float = nan  # of the angle's readings, as identified [s]
    duration: float = nan  # [s]
    furthest: float = nan  # greatest excursion over the wanted amplitude [-]
    scale: Scale | None = None  # inertia by a weight, relative to the given one
    left_out: tuple[float, ...] = ()  # amplitudes of the curve, for lack of time [rad]
    slowest: float = nan  # frequency of the slowest tone of K and felt K [Hz]; NaN of a log
    refusal: str = ""  # reason of a refusal; all of the above except posture and duration are NaN then

    @property
    def success(self) -> bool:
        """Whether it was measured."""
        return not self.refusal

    @property
    def strengths_std(self) -> tuple[float, float]:
        """Standard deviations of the strengths [-]."""
        return sqrt(self.covariance[0, 0]), sqrt(self.covariance[1, 1])

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the backbone K [N·m/rad]."""
        return self.K - _NORMAL * self.K_std, self.K + _NORMAL * self.K_std

    @classmethod
    def of(
        cls,
        plant: Plant,
        loop: Loop,
        findings: Findings,
        known: Known,
        step: float = 0.0,
        weight: float = 0.0,
    ) -> Self:
        """Return the result of the findings.

        `plant` is the model behind the commands, `loop` its hysteresis, `step` the encoder's [rad], `weight` the torque
        [N·m] of the added weight.
        """
        if findings.refusal or not findings.tones:
            return cls._refused(findings, findings.refusal or "the experiment ended before it had measured")
        A = float(np.mean([t.swing for i, t in enumerate(findings.tones) if i != WIDER]))
        why = why_not(findings.tones, A, None, _LEAST_STEPS * step)
        known = replace(known, loads=(*known.loads, _balance(plant, findings.tones[:4], A)))
        by_weight = findings.balance is not None
        found = None if why else solve(findings.tones, A, replace(known, inertia_error=0.0) if by_weight else known)
        if why := why or why_not(findings.tones, A, found, 0.0):
            return cls._refused(findings, why)
        assert found is not None
        if why := why_rubber(findings.tones, findings.curve, found, known.inertia):
            return cls._refused(findings, why)
        if findings.balance is None:
            return cls._measured(plant, loop, findings, found)
        scale = scale_of(plant, *findings.balance, weight, found.strengths)
        if not scale.std < _SCALE_KNOWN:
            return cls._refused(findings, "the weight moved the joint too little, or against its direction")
        if why := disagreement(known, scale):
            return cls._refused(findings, why)
        known = weighed(known, scale)
        found = solve(findings.tones, A, known)
        return replace(cls._measured(replace(plant, inertia=known.inertia), loop, findings, found), scale=scale)

    @classmethod
    def _refused(cls, findings: Findings, why: str) -> Self:
        at = findings.tones[0].middle if findings.tones else (nan, nan, nan)
        return cls(at[0], at[1:], duration=findings.duration, furthest=findings.furthest, refusal=why)

    @classmethod
    def _measured(cls, plant: Plant, loop: Loop, findings: Findings, found: Solution) -> Self:
        if why := why_implausible(found.strengths):
            return cls._refused(findings, why)
        middle = np.mean([t.middle for t in findings.tones[:4]], axis=0)
        theta, P = float(middle[0]), (float(middle[1]), float(middle[2]))
        k = np.array([float(s.stiffness(p)) for s, p in zip(plant.joint.sides(theta), P, strict=True)])
        g, C = np.array(found.strengths), found.covariance
        slow = [*findings.tones[:3], *findings.curve]
        curve = [_felt(tone, found, plant, loop, theta, P, C) for tone in slow]
        felt = (_mean(*curve[:2]), *curve[2:])
        by_model = float(g @ k)
        C = C + (_CABLES * max(felt[0].K / by_model - 1, 0.0)) ** 2 * np.outer(g, g)
        by_loops = backbone(slow, g, found.values["age"], plant.inertia, found.values["D"]) - _gravity(plant, theta)
        widest = max(felt, key=lambda f: f.amplitude)
        unsure = hypot(widest.K_std, SPRINGS * (widest.K - by_loops))
        K, error = _average((by_model, by_loops), (_SHAPE * by_model, unsure))
        return cls(
            theta, P, found.strengths, C, K, sqrt(float(k @ C @ k) + error**2), float(k.sum()), felt,
            found.values["D"], found.errors["D"], found.values["age"], findings.duration, findings.furthest,
            left_out=findings.left_out, slowest=min(tone.frequency for tone in slow),
        )  # fmt: skip

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Name, value and remark of everything measured, for tables."""
        g, s = self.strengths, self.strengths_std
        found = [
            ("strength of the agonist", f"{g[0]:.3f} ± {s[0]:.3f}", "times the model's"),
            ("strength of the antagonist", f"{g[1]:.3f} ± {s[1]:.3f}", "times the model's"),
            ("backbone K [N·m/rad]", f"{self.K:.3g} ± {self.K_std:.2g}", f"model {self.model_K:.3g}"),
        ]
        found += [
            (
                f"felt K at ±{f.amplitude / DEG:.2g}° [N·m/rad]",
                f"{f.K:.3g} ± {f.K_std:.2g}",
                f"loss factor {f.loss:.2f}; model {f.model:.3g}",
            )
            for f in self.felt
        ]
        if self.scale is not None:
            found.append(("inertia by the weight", f"{self.scale.ratio:.3f} ± {self.scale.std:.2g}", "times that told"))
        found += [(f"felt K at ±{A / DEG:.2g}° [N·m/rad]", "no time left", "") for A in self.left_out]
        return [*found, ("damping [N·m·s/rad]", f"{self.damping:.2g} ± {self.damping_std:.1g}", "")]

    @property
    def sentence(self) -> str:
        """One sentence with the result or the reason of a refusal."""
        at = f"about {self.theta / DEG:.1f}°, {self.pressures[0] / BAR:.2f} and {self.pressures[1] / BAR:.2f} bar"
        if self.refusal:
            return f"not measured, because {self.refusal}"
        rate = f" at {self.slowest:.2g} Hz" if isfinite(self.slowest) else ""
        return (
            f"{at}: strengths {self.strengths[0]:.3f} and {self.strengths[1]:.3f}, backbone K {self.K:.3g} ± "
            f"{self.K_std:.2g} N·m/rad{rate} (model {self.model_K:.3g})"
        )

    def to_dict(self) -> dict[str, object]:
        """Return everything by name, units in the names."""
        return {
            "measured": self.success,
            "message": self.sentence,
            "theta_deg": self.theta / DEG,
            "P1_bar": self.pressures[0] / BAR,
            "P2_bar": self.pressures[1] / BAR,
            "strengths": list(self.strengths),
            "strengths_covariance": self.covariance.tolist(),
            "stiffness_Nm_per_rad": self.K,
            "stiffness_std_Nm_per_rad": self.K_std,
            "stiffness_of_model_Nm_per_rad": self.model_K,
            "felt": [
                {
                    "amplitude_deg": f.amplitude / DEG,
                    "stiffness_Nm_per_rad": f.K,
                    "std_Nm_per_rad": f.K_std,
                    "loss_factor": f.loss,
                    "of_model_Nm_per_rad": f.model,
                }
                for f in self.felt
            ],
            "amplitudes_left_out_deg": [A / DEG for A in self.left_out],
            "inertia_by_weight": None if self.scale is None else self.scale.ratio,
            "slowest_tone_Hz": self.slowest if isfinite(self.slowest) else None,
            "damping_Nms_per_rad": self.damping,
            "age_s": self.age,
            "duration_s": self.duration,
        }


def _average(values: tuple[float, float], errors: tuple[float, float]) -> tuple[float, float]:
    """Return the average of two independent values and its error, greater if they differ by more than their errors."""
    weights = 1 / np.square(errors)
    mean = float(weights @ np.array(values) / weights.sum())
    return mean, max(1.0, abs(values[0] - values[1]) / hypot(*errors)) / sqrt(weights.sum())


def _gravity(plant: Plant, theta: float) -> float:
    """Return the stiffness of gravity [N·m/rad], which loops contain."""
    return float(plant.gravity.stiffness(theta))


def _balance(plant: Plant, tones: list[Tone], A: float) -> Load:
    """Return the balance of the mean torques during slow tones, whose symmetric loops have no mean of their own.

    Its error is a share of the torques, for sensors' offsets and the muscle model, and one of the loop's height.
    """
    one, two = np.mean([t.mean_torque for t in tones], axis=0).tolist()
    theta = float(np.mean([t.middle[0] for t in tones]))
    height = float(np.mean([abs(sum(t.loop().losses)) for t in tones])) * A
    error = sqrt((_BALANCED * (abs(one) + abs(two)) / 2) ** 2 + (_CENTRED * height) ** 2)
    return Load((one, two), float(plant.gravity.moment(theta)), error)


def _felt(
    tone: Tone, found: Solution, plant: Plant, loop: Loop, theta: float, P: tuple[float, float], C: Array
) -> Felt:
    """Return the felt stiffness of a slow tone; `C` (2, 2) is the covariance of the strengths."""
    g, age = np.array(found.strengths), found.values["age"]
    cycle = tone.loop(age)
    s = np.array(cycle.secants)
    K = secant(tone, g, age, plant.inertia, found.values["D"]) - _gravity(plant, theta)
    h = float(g @ np.array(cycle.losses))
    std = sqrt(float(s @ C @ s) + tone.error**2 + (_SCATTER * K) ** 2 + (LOSSY * h) ** 2)
    model = float(plant.joint.stiffness(theta, *P, amplitude=cycle.swing, loop=loop))
    return Felt(cycle.swing, K, std, h / K, model)


def _mean(one: Felt, two: Felt) -> Felt:
    """Return the mean of two tones of one amplitude, of one muscle each."""
    middle = [(a + b) / 2 for a, b in zip(one, two, strict=True)]
    return Felt(middle[0], middle[1], max(one.K_std, two.K_std) / sqrt(2) + abs(one.K - two.K) / 4, *middle[3:])


_BAND = 1.96  # of 95 %


def plot_measured(
    found: Sequence[MeasuredStiffness], joint: AntagonistJoint, loop: Loop, figure: "Figure | None" = None
) -> "Figure":
    """Draw K_felt(A) of each rest with 95 % bands, and the model's; returns the Matplotlib figure.

    `joint` and its `loop` of hysteresis are the model before the measurement.
    """
    from matplotlib.ticker import LogLocator, NullFormatter

    figure = new_figure(7, 5) if figure is None else figure
    axes = figure.subplots()
    for k, m in enumerate(m for m in found if m.success):
        A = np.array([f.amplitude for f in m.felt]) / DEG
        K, std = (np.array([getattr(f, name) for f in m.felt]) for name in ("K", "K_std"))
        at = f"{round(m.theta / DEG)}°"
        fine = np.geomspace(A.min() / 2, A.max() * 1.5, 120)
        felt = [joint.stiffness(m.theta, *m.pressures, amplitude=a * DEG, loop=loop) for a in fine]
        axes.plot(fine, felt, "--", color=f"C{k}", lw=1, label=f"model, {at}")
        axes.errorbar(A, K, _BAND * std, fmt="o", color=f"C{k}", capsize=3, label=f"measured, {at}")
        axes.axhspan(m.K - _BAND * m.K_std, m.K + _BAND * m.K_std, color=f"C{k}", alpha=0.2, lw=0)
        axes.axhline(m.K, color=f"C{k}", lw=1.5, label=f"backbone measured, {at}")
        axes.axhline(m.model_K, color=f"C{k}", lw=1, ls=":", label=f"backbone of the model, {at}")
    axes.set_xscale("log")
    axes.set_ylim(0)
    axes.set(xlabel="amplitude of the push [±°]", ylabel="stiffness [N·m/rad]")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())
    legend_below(axes)
    return figure
