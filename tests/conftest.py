"""The joints over which the laws are tested: every kind of muscle law, geometry and way of solving."""

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: every worker of the tests has a processor of its own

import numpy as np
import pytest
from hypothesis import settings

from allocator import AntagonistJoint, Lever, Pulley, Table, report_joint
from allocator.muscles import Hogan1984, Tondu2021
from allocator.muscles.catalogue import SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N, TONDU_MCKIBBEN
from allocator.units import BAR, DEG

sys.path.append(str(Path(__file__).parents[1]))  # `benchmarks`; last, so that what is installed is tested

os.environ.setdefault("ANTAGONIST_WAIT", "1")  # commands compile in their own process, and leave none behind

settings.register_profile("project", deadline=None, max_examples=30, derandomize=True)
settings.load_profile("project")

FIRST = (  # a minute or more each: begun before the others, so that no processor is left alone with one at the end
    "first_contact/test_readme_commands.py",
    "first_contact/test_every_muscle.py",
    "mpc/export/test_exported_controller.py",
    "mpc/export/test_exported_arm.py",
    "mpc/identification/test_identified_plant.py",
    "mpc/tuning/test_tune.py",
    "mpc/bench/test_afternoon.py",
    "benchmarks/test_tuned_strangers.py",
    "allocator/identification/joint/test_recovered_joint.py",
    "mpc/tuning/test_arm.py",
    "project/test_site.py",
    "project/test_notebooks.py",
)


def pytest_collection_modifyitems(items):
    """Order the tests by file: what a file's tests share is made once, and the longest files are first."""
    files = [Path(__file__).parent / file for file in FIRST]
    if missing := [str(file) for file in files if not file.is_file()]:
        raise pytest.UsageError(f"FIRST in {__file__} names what is not there: {', '.join(missing)}")
    items.sort(key=lambda item: (files.index(item.path) if item.path in files else len(files), item.path))


PULLEY = Pulley(rest_length=0.40, radius=0.02, initial_contraction=0.1375)
LEVER = Lever(rest_length=0.40, anchor=0.30, lever=0.03, offset=0.0435)
_ANGLES = np.linspace(-1.5, 1.5, 31)
TABLE = Table(0.40, _ANGLES, 0.13 + 0.04 * np.sin(_ANGLES), 0.13 - 0.045 * np.sin(_ANGLES))  # two different muscles
TONDU_C = Tondu2021.identify(0.0109, 25.5 * DEG, low=(3 * BAR, 0.225), high=(5 * BAR, 0.275), c=5 * BAR)
STOPS = (-80 * DEG, 80 * DEG)

JOINTS = {
    "report": report_joint(),
    "tondu-c-pulley": AntagonistJoint(PULLEY, TONDU_C, TONDU_C, angle_limits=STOPS),
    "mckibben-pulley": AntagonistJoint(Pulley(0.40, 0.02, 0.185), TONDU_MCKIBBEN, TONDU_MCKIBBEN, angle_limits=STOPS),
    "hogan-pulley": AntagonistJoint(
        PULLEY, Hogan1984(1500.0, 0.30, 5 * BAR), Hogan1984(1200.0, 0.28, 5 * BAR), angle_limits=STOPS
    ),
    "sarosi-pulley": AntagonistJoint(PULLEY, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N, angle_limits=STOPS),
    "sarosi-lever": AntagonistJoint(LEVER, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_200N, angle_limits=STOPS),
    "sarosi-table": AntagonistJoint(TABLE, SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N, angle_limits=STOPS),
    "tondu-lever": AntagonistJoint(LEVER, TONDU_DMSP_20_400N, TONDU_DMSP_20_400N, angle_limits=STOPS),
    "tondu-unequal-pulley": AntagonistJoint(PULLEY, TONDU_DMSP_20_400N, TONDU_C, angle_limits=STOPS),
}


@pytest.fixture(scope="session")
def shared():
    """Where data of development are that are not shipped, by their path: in $ANTAGONIST_SHARED, which .ci/run sets,
    or in a directory `shared` beside the checkout or above it."""

    def find(path):
        named = os.environ.get("ANTAGONIST_SHARED")
        places = [Path(named)] if named else [parent / "shared" for parent in Path(__file__).resolve().parents]
        found = [place / path for place in places if (place / path).exists()]
        if named or os.environ.get("CI"):
            assert found, f"no {path} in {' or '.join(map(str, places))}: this run has to have it"
        elif not found:
            pytest.skip(f"{path} is not shipped; put it into a directory `shared` beside the checkout to run this")
        return found[0]

    return find


@pytest.fixture(scope="session", params=JOINTS.values(), ids=JOINTS.keys())
def joint(request):
    return request.param


@pytest.fixture(scope="session")
def joints():
    return JOINTS
