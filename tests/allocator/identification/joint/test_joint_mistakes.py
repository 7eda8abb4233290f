"""Data that cannot be right, or cannot tell what is asked: one clear sentence each."""

import numpy as np
import pytest

from allocator import Lever
from allocator.identification.joint.fit import fit_joint
from allocator.units import BAR, DEG


@pytest.fixture
def data(all_twins, log_maker):
    joint = all_twins["martens-pulley"]
    log = log_maker(joint, 3)
    arrays = {name: getattr(log, name) for name in ("theta", "P1", "P2", "torque", "direction")}
    return {**arrays, "geometry": joint.geometry, "model": "MartensBoblan2017"}


def refused(data, sentence, **changes):
    with pytest.raises(ValueError, match=sentence) as error:
        fit_joint(**{**data, **changes})
    assert "\n" not in str(error.value)


def test_one_direction_only(data):
    keep = data["direction"] > 0
    few = {name: data[name][keep] for name in ("theta", "P1", "P2", "torque", "direction")}
    refused(data, "all equilibria were reached with rising θ", **few)


def test_all_points_slack(data):
    refused(data, "no equilibrium is left in which both muscles can be taut", dead_band=6 * BAR)


def test_one_cocontraction(data):
    total = 6 * BAR
    refused(data, "one co-contraction, P1 \\+ P2 = 6 bar", P2=total - data["P1"], theta=data["P1"] / total - 0.5)


def test_a_pressure_that_was_never_changed(data):
    refused(data, "P2 was never changed", P2=np.full_like(data["P1"], 3 * BAR))


def test_a_weight_too_small_to_see(data, all_twins, log_maker):
    log = log_maker(all_twins["martens-pulley"], 3, weight=0.005)
    names = ("theta", "P1", "P2", "torque", "direction")
    refused(data, r"drowns in a scatter of .*; hang about [0-9.]+ N·m", **{name: getattr(log, name) for name in names})


def test_degrees_for_radians(data):
    refused(data, "if degrees were meant", theta=data["theta"] / DEG)


def test_bar_for_pascal(data):
    refused(data, "if bar was meant", P1=data["P1"] / BAR)


def test_swapped_muscles(data):
    refused(data, "the muscles are swapped, or the angle has the other sign", P1=data["P2"], P2=data["P1"])


def test_an_angle_that_both_pressures_raise(data):
    refused(data, "in an antagonistic pair", theta=(data["P1"] + data["P2"]) / (20 * BAR))


def test_a_geometry_that_cannot_reach_the_angles(data):
    refused(data, "cannot be reached with this geometry", geometry=Lever(0.30, 0.60, 0.03, 0.0175))


def test_a_direction_that_is_none(data):
    refused(data, "direction has to be \\+1", direction=2 * data["direction"])


def test_too_few_equilibria(data):
    few = {name: data[name][::12] for name in ("theta", "P1", "P2", "torque", "direction")}
    refused(data, "equilibria cannot determine the .* unknowns", **few)


def test_several_geometries_need_labels(data):
    refused(data, "need group=", geometry={"a": data["geometry"]})


def test_an_unknown_model(data):
    refused(data, "unknown model 'Sarosi'", model="Sarosi")


def test_without_directions_the_report_says_where_hysteresis_goes(data):
    still = data["torque"] == 0
    fit = fit_joint(
        **{**data, **{name: data[name][still] for name in ("theta", "P1", "P2")}, "torque": None, "direction": None}
    )
    assert fit.friction == 0
    assert any("no direction of motion" in warning for warning in fit.warnings)


def test_swapped_directions_show_as_negative_friction(data):
    fit = fit_joint(**{**data, "direction": -data["direction"]})
    assert any("the directions look swapped" in warning for warning in fit.warnings)
