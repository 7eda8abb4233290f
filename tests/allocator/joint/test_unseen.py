"""What the data of a joint's fit leave open goes with the joint wherever it goes."""

from dataclasses import replace

import pytest

from allocator import InvalidInput, report_joint, save_machine
from allocator.errors import InvalidFile
from allocator.identification.joint.relative import RelativeJoint
from allocator.joint.limits import COMMON_FORCE, PRIOR_FORCE
from allocator.machine_file import load_joint

ASSUMED = replace(report_joint(), unseen=(COMMON_FORCE,))


def test_a_joint_of_known_muscles_assumes_no_slack_limit():
    assert report_joint().unseen == ()
    assert not report_joint().slack_assumed


@pytest.mark.parametrize("word", [COMMON_FORCE, PRIOR_FORCE])
def test_what_is_not_seen_comes_back_from_the_file(tmp_path, word):
    joint = replace(report_joint(), unseen=(word,))
    save_machine(joint, tmp_path / "joint.toml")
    assert load_joint(tmp_path / "joint.toml") == joint
    assert load_joint(tmp_path / "joint.toml").slack_assumed


def test_a_word_that_means_nothing_is_refused(tmp_path):
    save_machine(ASSUMED, tmp_path / "joint.toml")
    text = (tmp_path / "joint.toml").read_text(encoding="utf-8").replace("both muscles", "none of them")
    (tmp_path / "joint.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidFile, match=f"unseen has no 'a .* none of them'; it may have '{COMMON_FORCE}'"):
        load_joint(tmp_path / "joint.toml")
    for wrong in (("friction",), "friction", 3, (None,), (["a"],)):
        with pytest.raises(InvalidInput, match="unseen has no"):
            replace(report_joint(), unseen=wrong)


def test_a_joint_without_a_scale_states_what_its_fit_left_open():
    relative = RelativeJoint(ASSUMED)
    assert relative.slack_assumed
    assert relative.unseen == (COMMON_FORCE,)
