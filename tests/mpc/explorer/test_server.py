"""The explorer's server answers on this machine, and its page works in a browser."""

import json
import math
import re
import shutil
import socket
import threading
from contextlib import contextmanager
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path

import pytest
from typer.testing import CliRunner

from allocator import DEG, AntagonistJoint, Lever, Stiffness, allocate, named_muscle, report_joint
from mpc import Plant, TrackingMPC, simulate, sine
from mpc.cli import app
from mpc.explorer.server import HOST, frames, server
from mpc.trials.files import save_recording


@contextmanager
def serving(run=None, joint=None):
    with server(joint or report_joint(), run, 0) as running:
        thread = threading.Thread(target=running.serve_forever, daemon=True)
        thread.start()
        yield running.server_address[1]
        running.shutdown()
        thread.join()


def get(port, path, host=None):
    connection = HTTPConnection(HOST, port)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    answer = connection.getresponse()
    return answer.status, answer.read()


def test_the_server_gives_the_page_and_answers_questions():
    with serving() as port:
        status, page = get(port, "/")
        assert status == 200
        assert b"<title>" in page
        status, state = get(port, "/state?theta=30&stiffness=7.5&torque=1")
        assert status == 200
        assert [f"{P:.4f}" for P in json.loads(state)["pressures"]] == ["3.2551", "2.1584"]
        assert json.loads(get(port, "/joint")[1])["run"] is None
        assert get(port, "/nothing")[0] == 404
        status, said = get(port, "/state?theta=x")
        assert (status, json.loads(said)) == (400, {"error": "theta = 'x' is no number"})


def test_a_connection_that_asks_nothing_is_closed(monkeypatch):
    """Otherwise a thread waits for ever for each of them."""
    monkeypatch.setattr("mpc.explorer.server._Handler.timeout", 0.05)
    with serving() as port, socket.create_connection((HOST, port), timeout=60) as idle:
        assert idle.recv(1) == b""
        assert get(port, "/joint")[0] == 200  # and the others are answered


def test_a_page_of_elsewhere_is_refused():
    with serving() as port:
        assert get(port, "/joint", host=f"elsewhere.example:{port}")[0] == 403


def test_the_page_asks_nothing_of_the_internet():
    page = (Path(__file__).parents[3] / "mpc" / "explorer" / "page.html").read_text()
    assert re.findall(r"https?://(?!www\.w3\.org/2000/svg)", page) == []


@pytest.mark.compiles
def test_a_run_is_replayed(tmp_path):
    run = simulate(Plant(), TrackingMPC(Plant(), dt=0.02, N=10), sine(duration=2.0, ramp=0.5))
    save_recording(run, tmp_path / "run.npz")
    found = frames(tmp_path / "run.npz")
    assert found["theta"][0] == pytest.approx(float(run.x[0, 0]))
    assert len(found["t"]) == len(found["muscles"]) <= 800
    assert found["muscles"][3][0]["pressure"] == pytest.approx(run.x[3, 2] / 1e5)


@pytest.mark.compiles
def test_a_port_in_use_is_named():
    with serving() as port:
        result = CliRunner().invoke(app, ["explore", "--no-browser", "--port", str(port)])
    assert f"--port {port} cannot be used" in str(result.exception)


CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("chromium-browser")


FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


@pytest.mark.tools
@pytest.mark.slow
def test_a_lever_is_drawn_as_a_lever_and_its_sliders_move_it():
    from playwright.sync_api import sync_playwright

    assert CHROMIUM is not None, "a Chromium is needed: apt install chromium"
    muscle = named_muscle("sarosi-dmsp-20-400n")
    lever = AntagonistJoint(Lever(rest_length=0.25, anchor=0.1655, lever=0.05094, offset=0.051), muscle, muscle)
    with serving(joint=lever) as port, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page()
        page.goto(f"http://{HOST}:{port}/")
        page.wait_for_selector("body[data-ready]", state="attached")
        assert page.locator("#joint .pulley").count() == 0
        assert page.locator("#joint .anchor").count() == 2
        page.fill("#theta", "10")
        page.click("summary")
        distance = page.locator("#joint .end")
        before = [distance.get_attribute(name) for name in ("cx", "cy")]
        page.fill("#lever", "70")
        page.wait_for_function(f"document.querySelector('#joint .end').getAttribute('cy') !== '{before[1]}'")
        x, y = (float(distance.get_attribute(name)) for name in ("cx", "cy"))
        assert (210 - x) / (y - 140) == pytest.approx(math.tan(math.radians(10)))  # towards the agonist's anchor
        browser.close()


@pytest.mark.tools
@pytest.mark.slow
def test_the_page_shows_backbone_felt_and_shut_stiffness_and_a_slider_changes_all_three():
    from playwright.sync_api import sync_playwright

    assert CHROMIUM is not None, "a Chromium is needed: apt install chromium"
    rubbing = replace(report_joint(named_muscle("sarosi-dmsp-20-400n")), friction=0.05)
    with serving(joint=rubbing) as port, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page()
        page.goto(f"http://{HOST}:{port}/")
        page.wait_for_selector("body[data-ready]", state="attached")
        seen = []
        for K in (5.0, 7.0):
            page.fill("#stiffness", str(K))
            page.wait_for_function(f"document.getElementById('backbone').textContent.startsWith('{K:.2f}')")
            seen.append([page.inner_text(f"#{name}") for name in ("backbone", "felt", "shut")])
            a = allocate(0.0, K, 0.0, joint=rubbing)
            kinds = Stiffness(), Stiffness(amplitude=2 * DEG), Stiffness("shut")
            expected = [float(rubbing.stiffness(0.0, a.P1, a.P2, s.valves, amplitude=s.amplitude)) for s in kinds]
            assert seen[-1] == [f"{value:.2f} N·m/rad" for value in expected]
            assert expected[0] < min(expected[1:])
        assert all(one != two for one, two in zip(*seen, strict=True))
        browser.close()


@pytest.mark.tools
@pytest.mark.slow
def test_the_page_works_in_a_browser():
    from playwright.sync_api import sync_playwright

    assert CHROMIUM is not None, "a Chromium is needed: apt install chromium"
    with serving() as port, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        for width in (360, 1280):
            page = browser.new_page(viewport={"width": width, "height": 800})
            said = []
            page.on("console", lambda message, said=said: said.append(message.text))
            page.on("pageerror", lambda error, said=said: said.append(str(error)))
            page.goto(f"http://{HOST}:{port}/")
            page.wait_for_selector("body[data-ready]", state="attached")
            page.fill("#theta", "30")
            page.fill("#stiffness", "7.5")
            page.fill("#torque", "1")
            page.wait_for_function("document.getElementById('P1').textContent.startsWith('3.2550')")
            assert page.inner_text("#P2") == "2.15841"
            assert page.inner_text("#binding") == "none"
            assert page.inner_text("#felt").endswith("no hysteresis known")
            page.focus("#stiffness-slider")
            before = page.inner_text("#K")
            page.keyboard.press("ArrowRight")  # the keyboard moves it
            page.wait_for_function(f"document.getElementById('K').textContent !== '{before}'")
            page.fill("#stiffness", "12")
            page.wait_for_function("document.getElementById('binding').textContent === 'P1 upper'")
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            unlabelled = "[...document.querySelectorAll('input,select')].filter(i => !i.labels.length && !i.ariaLabel)"
            assert page.evaluate(f"{unlabelled}.length") == 0
            assert said == []
        browser.close()


@pytest.mark.tools
@pytest.mark.slow
def test_a_saved_page_answers_without_the_server(tmp_path, monkeypatch):
    from playwright.sync_api import sync_playwright

    assert CHROMIUM is not None, "a Chromium is needed: apt install chromium"
    for name, steps in (("_ANGLES", 8), ("_STIFFNESSES", 8), ("_TORQUES", 6)):
        monkeypatch.setattr(f"mpc.explorer.server.{name}", steps)
    assert CliRunner().invoke(app, ["explore", "--save", str(tmp_path / "page.html")]).exit_code == 0
    with sync_playwright() as driver:
        page = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS).new_page()
        said = []
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto((tmp_path / "page.html").as_uri())
        page.wait_for_selector("body[data-ready]", state="attached")
        assert float(page.input_value("#stiffness")) == float(page.inner_text("#K").split()[0])
        for name, value in (("theta", "28"), ("stiffness", "6.6"), ("torque", "4")):
            page.fill(f"#{name}", value)
            page.press(f"#{name}", "Enter")
        target = [float(page.input_value(f"#{name}")) for name in ("theta", "stiffness", "torque")]
        answer = allocate(math.radians(target[0]), *target[1:])
        shown = [float(page.inner_text(f"#P{i}")) for i in (1, 2)]
        assert shown == pytest.approx([answer.P1 / 1e5, answer.P2 / 1e5], abs=1e-5)
        assert float(page.inner_text("#K")) == pytest.approx(answer.K, abs=1e-4)
        page.click("#map", position={"x": 60, "y": 60})  # a target out of reach
        page.wait_for_function("document.getElementById('status').className === 'missed'")
        assert not page.is_visible("#valves")
        assert said == []


def test_a_saved_page_is_not_written_over_another_file(tmp_path):
    (tmp_path / "page.html").write_text("mine")
    result = CliRunner().invoke(app, ["explore", "--save", str(tmp_path / "page.html")])
    assert "--force" in str(result.exception)
    assert (tmp_path / "page.html").read_text() == "mine"
