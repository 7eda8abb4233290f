"""Weights that give a loop the sensitivity peak that is asked for."""

import numpy as np
import pytest

from allocator import DEG, InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Compensation, KalmanObserver, Noise, Plant, TrackingMPC, robust_weights
from mpc.model.friction.dahl import Friction
from mpc.tracking.cost import Weights
from mpc.trials.loops import Settings, margins_in_words, robust
from mpc.trials.margins import margins, usual_postures
from mpc.trials.motions.reference import Reference
from mpc.trials.pictures.report import plot_margins
from mpc.trials.robust import SLOWEST, NotRobust, _root

pytestmark = pytest.mark.compiles

DT = 0.01
PLANT = Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12)


def peaks(weights, dead_time, noise=None):
    told = Compensation(dead_time=dead_time)
    loop = TrackingMPC(PLANT, DT, weights=weights, compensation=told), KalmanObserver(PLANT, DT, noise, told)
    return margins(*loop)


@pytest.mark.parametrize("dead_time", [0.0, 0.03])
def test_the_loop_has_the_peak_that_was_asked_for_at_each_posture(dead_time):
    found = peaks(robust_weights(PLANT, DT, compensation=Compensation(dead_time=dead_time)), dead_time)
    assert [m.sensitivity_peak for m in found] == pytest.approx([2.0] * 3, rel=0.07)
    assert min(m.delay_margin for m in found) >= 2 * DT
    assert found[1].sensitivity_peak == pytest.approx(2.0, rel=0.03)


def test_weights_fit_the_observer_s_noise_which_raises_the_inertia_margin():
    told, careful = Compensation(dead_time=0.03), Noise(omega_walk=4.0)
    weights, usual = (
        robust_weights(PLANT, DT, compensation=told, sensitivity_peak=1.7, noise=noise) for noise in (careful, None)
    )
    own, other = peaks(weights, 0.03, careful)[1], peaks(usual, 0.03)[1]
    assert own.sensitivity_peak == pytest.approx(1.7, rel=0.03) == other.sensitivity_peak
    assert weights.rate < usual.rate  # a quicker loop …
    assert own.inertia_margin > 1.1 * other.inertia_margin  # … that carries more


def test_more_robust_weights_are_slower():
    told = Compensation(Friction(mu=0.05), dead_time=0.02)  # the friction has no part
    quick, slow = (robust_weights(PLANT, DT, compensation=told, sensitivity_peak=peak) for peak in (2.2, 1.6))
    assert slow.rate > quick.rate
    assert slow.theta < quick.theta
    assert peaks(slow, 0.02)[1].sensitivity_peak == pytest.approx(1.6, rel=0.03)


def test_settings_of_controllers_without_weights_stay():
    settings = Settings(PLANT, DT)
    assert robust("pid", settings) is settings
    assert robust("lqr", settings).weights == robust("mpc", settings).weights != settings.weights


def test_weights_and_margins_are_for_postures_within_reach():
    """At 80 N·m/rad a muscle stays at its supply: the loop is not linear, and its M_s says nothing."""
    t, settings = DT * np.arange(3), Settings(PLANT, DT)
    beyond, within = (Reference(t, 0.1 + 0 * t, K + 0 * t) for K in (80.0, 6.0))
    assert robust("mpc", settings, beyond).weights == robust("mpc", settings).weights
    said = [margins_in_words("mpc", settings, asked, Quick())[0] for asked in (beyond, within)]
    K = usual_postures(PLANT)[1][1]
    assert f"K = {K:.1f} N·m/rad" in said[0]
    assert "θ = 6°, K = 6.0 N·m/rad" in said[1]


class Quick:
    """Controller whose step is compiled."""

    implementation = "compiled"


def test_the_search_ends_at_the_end_of_the_range_where_no_detuning_is_enough():
    assert _root(lambda s: np.inf) == (pytest.approx(SLOWEST), np.inf)
    assert _root(lambda s: 1.0) == (pytest.approx(SLOWEST), 1.0)
    assert _root(lambda s: 1.3 - np.log(s))[0] == pytest.approx(np.exp(1.3), rel=0.05)


def test_weights_that_are_not_robust_are_not_returned_in_silence():
    slow = Compensation(dead_time=0.25)
    with pytest.warns(NotRobust, match=r"no weights reach M_s = 1.1: .*Noise.d_walk"):
        weights = robust_weights(PLANT, compensation=slow, sensitivity_peak=1.1)
    assert weights == Weights.calm(SLOWEST)


def test_wrong_numbers_are_refused():
    with pytest.raises(InvalidInput, match="above 1"):
        robust_weights(PLANT, sensitivity_peak=0.9)
    with pytest.raises(InvalidInput, match="detuning"):
        Weights.calm(0.0)


def test_the_picture_shows_each_posture(tmp_path):
    found = peaks(Weights.calm(), 0.0)
    figure = plot_margins(found, tmp_path / "margins.png", "a loop")
    _, spectrum = figure.axes
    assert [text.get_text().split(":")[0] for text in spectrum.get_legend().get_texts()] == [
        f"θ = {m.theta / DEG:.0f}°, K = {m.K:.1f} N·m/rad" for m in found
    ]
    assert (tmp_path / "margins.png").stat().st_size > 10_000


def test_without_compiled_code_a_sentence_stands_for_the_margins():
    class Slow:
        implementation = "readable"

    reference = Reference(DT * np.arange(3), np.zeros(3), np.full(3, 6.0))
    said = margins_in_words("mpc", Settings(PLANT, DT), reference, Slow())
    assert said == ["margins of the loop are computed once its controller is compiled"]
