"""Whatever is given to `antagonist`, it answers with one clear sentence and an exit code, never with a traceback."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow  # 70 commands are run for it

BIG = "9" * 400
LONG = "1" * 140_000  # over the 131 072 characters that Python's csv takes
FILES = {
    "quote.csv": 'contraction,pressure_bar,force_N\n0.1,2,"500\n0.2,2,300\n',
    "cell.csv": f"contraction,pressure_bar,force_N\n0.1,2,{LONG}\n",
    "twice.csv": "contraction,pressure_bar,pressure_bar,force_N\n0.1,2,2,500\n0.2,2,2,300\n",
    "int.csv": f"contraction,pressure_bar,force_N\n0.1,2,{BIG}\n0.2,2,300\n",
    "log_quote.csv": 'theta_deg,pressure1_bar,pressure2_bar\n0,1,"2\n1,2,3\n',
    "t.csv": "t,theta_deg,stiffness\n0,0,7\n1,1,7\n",
    "t_quote.csv": 't,theta_deg,stiffness\n0,0,"7\n1,0,7\n',
    "t_cell.csv": f"t,theta_deg,stiffness\n0,0,7\n1,{LONG},7\n",
    "t_long.csv": "t,theta_deg,stiffness\n0,0,7\n1e9,1,7\n",
    "t_twice.csv": "t,t,theta_deg,stiffness\n0,0,0,7\n1,1,1,7\n",
    "t_int.csv": f"t,theta_deg,stiffness\n0,0,7\n{BIG},1,7\n",
    "p_max.toml": 'model = "Hogan1984"\n[parameters]\nF_max = 1500.0\neps_max = 0.3\nP_max = 0\n',
    "int.toml": f'model = "Hogan1984"\n[parameters]\nF_max = {BIG}\neps_max = 0.3\nP_max = 500000\n',
    "digits.toml": f"x = {'9' * 5000}\n",
    "nested.toml": f"x = {'[' * 3000}\n",
    "plant_int.toml": f"[plant]\ninertia = {BIG}\n",
    "plant_typo.toml": "[plant]\ninertja = 0.1\n",
    "one_row.csv": "eps [%],p [bar],F [N]\n5,3,400\n",
    "t_short.csv": "t,theta_deg,stiffness\n0,0,7\n1e-9,1,7\n",
    "p_two.toml": 'model = "Hogan1984"\n[parameters]\nF_max = 1500.0\n',
    "afile": "x",
}
HELD = ("allocate", "--theta", "0", "--stiffness", "7")
SAROSI = ("fit", "--model", "Sarosi2012")
CASES = {
    # files
    ("fit", "quote.csv"): "quote.csv, line 2: a quotation mark is not closed",
    ("fit", "cell.csv"): "cell.csv, line 2: a cell has over 131072 characters",
    ("fit", "twice.csv"): "twice",
    ("fit", "int.csv"): "is not a finite number",
    ("fit-joint", "log_quote.csv", "--pulley", "20,0.1", "--rest-length", "400"): "a quotation mark is not closed",
    ("track", "t_quote.csv"): "t_quote.csv, line 2: a quotation mark is not closed",
    ("track", "t_cell.csv"): "t_cell.csv, line 3: a cell has over 131072 characters",
    ("track", "t_twice.csv"): "column 't': there are two columns of t",
    ("track", "t_long.csv"): "the reference takes 1e+09 s, which is 1e+11 samples of dt = 0.01 s; at most 1,000,000",
    ("track", "t_int.csv"): "… is not a finite number",
    (*HELD, "--muscle", "p_max.toml"): "cannot be computed (float division by zero); check F_max = 1500",
    (*HELD, "--muscle", "int.toml"): "is not a finite number",
    (*HELD, "--muscle", "digits.toml"): "digits.toml: is not TOML",
    (*HELD, "--muscle", "nested.toml"): "nested too deeply",
    (*HELD, "--machine", "nested.toml"): "nested too deeply",
    (*HELD, "--machine", "p_max.toml"): "is not a machine: the table [machine] is missing",
    ("track", "t.csv", "--machine", "own_int.toml"): "inertia = int is not a number",
    ("track", "t.csv", "--machine", "own_typo.toml"): "[plant] has no inertja; it has inertia, damping",
    ("fit", "one_row.csv"): "no force law can be fitted: 1 taut samples cannot determine the 2 parameters of Hogan1984",
    ("track", "t_short.csv"): "the reference takes 1e-09 s, which is less than one sample of dt = 0.01 s",
    ("map", "--muscle", "p_two.toml"): "needs the parameters eps_max, P_max, which are missing",
    # numbers
    ("track", "t.csv", "--horizon", "100000"): "N = 100000 is over 1000",
    ("track", "t.csv", "--horizon", "1000000000"): "N = 1000000000 is over 1000",
    ("track", "t.csv", "--horizon", BIG): "is over 1000",
    ("track", "t.csv", "--horizon", "1000000000", "--controller", "nmpc"): "is over 1000",
    ("export", "controller", "--out", "c", "--horizon", "1000000000"): "is over 1000",
    ("track", "t.csv", "--dt", "1e-9"): "1e+09 samples of dt = 1e-09 s",
    ("track", "t.csv", "--dt", "nan"): "dt = nan is not finite [s]",
    ("track", "t.csv", "--payload", "nan"): "--payload nan: expected a finite number [N·m]",
    ("track", "t.csv", "--inertia", "0"): "--inertia 0: expected 1e-09 to 1e+06 kg·m²",
    ("track", "t.csv", "--inertia", "1e-9"): "steps of integration, over 10000; check inertia 1e-09 kg·m²",
    ("track", "t.csv", "--lag", "1e-300"): "--lag 1e-300: expected 0.0001 to 10 s",
    ("track", "t.csv", "--lag", "1:2:3"): "--lag 1:2:3: expected NUMBER or LOW:HIGH",
    ("track", "t.csv", "--slew", "inf"): "--slew inf: expected 0.001 to 100000 bar/s",
    ("export", "controller", "--out", "c", "--gravity", "nan"): "--gravity nan: expected",
    ("track", "t.csv", "--gravity", "3,40,1"): "--gravity 3,40,1: expected 1 (G) or 2 (G,θh) numbers",
    ("map", "--supply", "500000"): "--supply 500000: expected 0.05 to 100 bar",
    ("map", "--radius", "2e9"): "--radius 2e+09: expected 0.1 to 10000 mm",
    ("map", "--rest-length", "-5"): "--rest-length -5: expected 1 to 10000 mm",
    ("map", "--radius", "nan"): "--radius nan: expected",
    ("map", "--stops", "nan:90"): "--stops nan: expected -360 to 360 degrees",
    ("map", "--stops", "10:-10"): "--stops 10:-10: the first angle has to be below the second",
    ("map", "--theta", "400:500"): "--theta 400:500: an angle is over a turn",
    ("track", "t.csv", "--payload", "40"): "--payload 40: the joint holds 26.1 N·m at most",
    ("map", "--torque", "0:1e-300"): "--torque from 0 to 1e-300 N·m is too narrow a range to be shown",
    ("map", "--initial-contraction", "13.75"): "a ratio, not percent",
    ("map", "--min-force", "nan"): "min_force",
    ("map", "--max-memory", "nan"): "--max-memory nan: expected",
    ("fit", "--min-pressure", "nan"): "--min-pressure nan: expected -1 to 100 bar",
    ("fit", "--min-contraction", "20"): "--min-contraction 20: expected -1 to 1 (a ratio, not percent)",
    ("fit", "--rest-length", "-5"): "--rest-length -5: expected",
    (*HELD, "--min-force", "nan"): "min_force",
    ("allocate", "--theta", BIG, "--stiffness", "7"): "--theta inf: expected a finite number",
    ("allocate", "--theta", "0", "--stiffness", BIG): "K = inf is not finite",
    # options
    (*HELD, "--theta", "1"): "--theta is given 2 times",
    ("map", "--supply", "4", "--supply", "5"): "--supply is given 2 times",
    (*HELD, "--muscle", "tondu-mckibben", "--muscle", "sarosi-dmsp-20-400n"): "--agonist and --antagonist",
    (*HELD, "--muscle", "biceps"): "unknown muscle 'biceps'; available: a file ending in .toml, martens",
    ("map", "--machine", "lever.toml", "--radius", "20"): "are for a pulley; lever.toml has a Lever",
    # what cannot be written
    (*SAROSI, "--out", "directory"): "directory cannot be written (it is a directory)",
    (*SAROSI, "--out", "afile/x.toml"): "afile/x.toml cannot be written (afile is a file, not a directory)",
    (*SAROSI, "--out", "/dev/full"): "/dev/full cannot be written (No space left on device)",
    (*SAROSI, "--plot", "afile/x.png"): "afile/x.png cannot be written",
    (*SAROSI, "--plot", "x.docx"): "--plot x.docx: the ending has to be one of .png",
    ("map", "--out", "afile/x.csv"): "afile/x.csv cannot be written",
    ("init", "directory"): "directory cannot be written (it is a directory)",
    (*SAROSI, "--out", "x.csv"): "--out x.csv: the ending has to be .toml",
    ("init", "x.txt"): "FILE x.txt: the ending has to be .toml",
    ("tune", "--machine", "arm26", "--out", "x"): "--out x: the ending has to be .toml",
    ("explore", "--save", "x.txt"): "--save x.txt: the ending has to be one of .html",
    ("export", "allocation", "--out", "afile/c"): "afile/c cannot be written",
    ("track", "t.csv", "--out", "afile/run.npz"): "afile/run.npz cannot be written",
}
DISK_FULL = [
    ("map", "--out", "full.csv"),
    ("map", "--out", "full.npz"),
    ("map", "--out", "full.png"),
    ("init", "full.toml"),
    ("export", "allocation", "--out", "full"),
]


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """What each command answers, by its arguments."""
    here = tmp_path_factory.mktemp("hostile")
    for name, text in FILES.items():
        (here / name).write_text(text, encoding="utf-8")
    (here / "directory").mkdir()
    shipped = (Path(__file__).parents[3] / "mpc" / "data" / "joint.toml").read_text(encoding="utf-8")
    joint = shipped.partition("[plant]")[0]
    for kind in ("int", "typo"):
        (here / f"own_{kind}.toml").write_text(joint + FILES[f"plant_{kind}.toml"], encoding="utf-8")
    lever = 'kind = "Lever"\nrest_length = 0.4\nanchor = 0.3\nlever = 0.03\noffset = 0.0435\n'
    before, _, rest = joint.partition('kind = "Pulley"')
    (here / "lever.toml").write_text(before + lever + rest[rest.index("# A lever") :], encoding="utf-8")
    there = sorted(path.name for path in here.iterdir())
    cases = [{"arguments": a, "file_size": None} for a in CASES]
    cases += [{"arguments": a, "file_size": 2000} for a in DISK_FULL]
    command = [sys.executable, str(Path(__file__).with_name("forked.py"))]
    environment = {**os.environ, "COLUMNS": "200"}
    done = subprocess.run(
        command, input=json.dumps(cases), capture_output=True, text=True, check=True, cwd=here, env=environment
    )
    return dict(zip([*CASES, *DISK_FULL], json.loads(done.stdout), strict=True)) | {
        "left": sorted({path.name for path in here.iterdir()} - set(there))
    }


def name(arguments):
    return " ".join(arguments)[:60]


@pytest.mark.parametrize("arguments", CASES, ids=name)
def test_nonsense_is_one_sentence_and_exit_code_2(arguments, answers):
    answer = answers[arguments]
    assert CASES[arguments] in answer["stderr"]
    assert answer["stderr"].startswith("antagonist: ")
    assert answer["stderr"].count("\n") == 1
    assert answer["code"] == 2


@pytest.mark.parametrize("arguments", DISK_FULL, ids=name)
def test_a_full_disk_is_one_sentence_and_exit_code_2(arguments, answers):
    answer = answers[arguments]
    assert "cannot be written (File too large)" in answer["stderr"]
    assert answer["stderr"].count("\n") == 1
    assert answer["code"] == 2


def test_nothing_is_left_of_what_failed(answers):
    assert answers["left"] == []
