"""Designs and sweeps over them: values, executors, resuming."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

from allocator import InvalidFile, InvalidInput, report_joint
from allocator.feasibility import (
    Design,
    design_grid,
    design_sweep,
    performance,
    stiffness_interval,
    torque_interval,
)
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG

STOPS = (-90 * DEG, 90 * DEG)
DESIGNS = design_grid(radius=[0.015, 0.02, 0.025], initial_contraction=[0.1, 0.1375, 0.16], supply_pressure=[4e5, 5e5])


def test_the_report_s_design_holds_7_03_to_8_29_over_125_degrees():
    found = performance(Design(), stops=report_joint().angle_range)
    assert (found.left / DEG, found.right / DEG) == pytest.approx((-125, 125))
    assert (found.K_low, found.K_high) == pytest.approx((7.027, 8.288), abs=1e-3)
    assert found.torque_reserve == pytest.approx(torque_interval(125 * DEG)[1])
    assert found.range == pytest.approx(250 * DEG)


@pytest.mark.parametrize("design", DESIGNS[::5], ids=str)
def test_performance_is_what_a_fine_search_over_the_angles_finds(design):
    found = performance(design, SAROSI_DMSP_20_400N, STOPS)
    joint = design.joint(SAROSI_DMSP_20_400N, STOPS)
    theta = np.linspace(*joint.angle_range, 20_001)
    K_min, K_max = stiffness_interval(theta, joint=joint)
    held = np.isfinite(K_min)
    assert (found.left, found.right) == pytest.approx((theta[held].min(), theta[held].max()), abs=2e-4)
    assert (found.K_low, found.K_high) == pytest.approx((K_min[held].max(), K_max[held].min()), rel=2e-3)
    T_min, T_max = torque_interval(theta[held], joint=joint)
    assert found.torque_reserve == pytest.approx(np.minimum(-T_min, T_max).min(), rel=2e-3, abs=5e-3)


def test_a_design_that_reaches_nothing_says_so():
    assert np.isnan(performance(Design(initial_contraction=0.02))).all()
    assert np.isnan(performance(Design(initial_contraction=0.34))).all()  # slack at every angle


def test_more_supply_pressure_never_takes_anything_away():
    weak, strong = (performance(Design(supply_pressure=P), stops=STOPS) for P in (4 * BAR, 5 * BAR))
    assert strong.K_high > weak.K_high
    assert strong.torque_reserve > weak.torque_reserve
    assert strong.K_low == pytest.approx(weak.K_low)


def test_a_sweep_gives_every_design_in_order():
    sweep = design_sweep(DESIGNS, stops=STOPS)
    assert sweep.designs == DESIGNS
    assert sweep.column("band") == pytest.approx([performance(d, stops=STOPS).band for d in DESIGNS])
    assert (sweep.column("radius") == [d.radius for d in DESIGNS]).all()
    with pytest.raises(InvalidInput, match="no column 'mass'; it has radius"):
        sweep.column("mass")


@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_an_executor_gives_the_same_answer(pool):
    with pool(2) as executor:
        assert design_sweep(DESIGNS, stops=STOPS, executor=executor) == design_sweep(DESIGNS, stops=STOPS)


def test_a_dask_cluster_of_two_workers_gives_the_same_answer():
    import distributed

    options = {"n_workers": 2, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        found = design_sweep(DESIGNS, stops=STOPS, executor=client.get_executor())
        assert len(client.scheduler_info()["workers"]) == 2
    assert found == design_sweep(DESIGNS, stops=STOPS)


def test_an_interrupted_sweep_goes_on_where_it_stopped(tmp_path):
    path = tmp_path / "sweep.csv"
    whole = design_sweep(DESIGNS, stops=STOPS)
    design_sweep(DESIGNS[:5], stops=STOPS, out=path)
    with path.open("a", encoding="utf-8") as file:
        file.write("0.015,0.4,0.1")  # cut off in the middle of a row
    computed = []

    def progress(answers, total):
        assert total == len(DESIGNS) - 5
        for answer in answers:
            computed.append(answer[0])
            yield answer

    assert design_sweep(DESIGNS, stops=STOPS, out=path, progress=progress) == whole
    assert computed == list(DESIGNS[5:])
    assert len(path.read_text(encoding="utf-8").splitlines()) == 2 + len(DESIGNS)
    assert design_sweep(DESIGNS, stops=STOPS, out=path) == whole


def test_a_file_of_another_sweep_is_refused(tmp_path):
    path = tmp_path / "sweep.csv"
    design_sweep(DESIGNS[:1], stops=STOPS, out=path)
    with pytest.raises(
        InvalidFile, match="line 1: is not a sweep of this muscle and these limits; it should begin with"
    ):
        design_sweep(DESIGNS[:1], stops=STOPS, out=path, muscle=SAROSI_DMSP_20_400N)
    with path.open("a", encoding="utf-8") as file:
        file.write("a,b\n")
    with pytest.raises(InvalidFile, match="line 4: 'a,b' is not a row of 9 numbers"):
        design_sweep(DESIGNS[:1], stops=STOPS, out=path)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: design_sweep([]), "got no designs"),
        (lambda: design_sweep([(0.02, 0.4)]), "takes Design objects"),
        (lambda: design_grid(supply_pressure=[4.0, 5.0]), "if bar was meant"),
        (lambda: design_grid(radius="wide"), "radius = 'wide' is not a number"),
        (lambda: performance(Design(radius=-0.02)), "radius = -0.02"),
    ],
)
def test_wrong_input_is_one_sentence(call, said):
    with pytest.raises(InvalidInput, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)
