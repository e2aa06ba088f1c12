"""The page in a real browser, before a robot that really drives in a simulated house."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest
from chromium import Tab, open_chromium
from live_house import HERE, TOKEN, House, open_house
from live_patience import eventually
from simulated import simulated
from task_facts import INSTRUCTION as TASK
from task_facts import by_a_model, driving, looking

from edge.host.service_manager import SystemdNotifier
from edge.host.web_server import serve
from edge.live.view import LiveView
from edge.loop.monitoring.service_health import ServiceHealth
from edge.memory import KnownObject
from edge.sources.synchronizer import TimeSynchronizer

SLOWLY = {"max_speed_mps": 0.15}
INSTRUCTION = "find the <b>sofa</b>"


@pytest.fixture(scope="module")
def tab() -> Iterator[Tab]:
    with open_chromium() as tab:
        tab.size(1400, 900)
        yield tab


@pytest.fixture
def house() -> Iterator[House]:
    with open_house(robot=SLOWLY) as house:
        yield house


@pytest.fixture
def page(tab, house) -> Tab:
    """Open the page for a viewer with the token."""
    tab.open(house.url)
    tab.run(f"sessionStorage.setItem('edge-token', '{TOKEN}')")
    tab.asked.clear()
    tab.open(house.url)
    tab.complaints.clear()
    tab.says("#phase", "SEARCHING")
    return tab


def painted(tab: Tab, canvas: str) -> int:
    return tab.run(
        f"""(() => {{
          const c = document.getElementById("{canvas}");
          const {{ data }} = c.getContext("2d").getImageData(0, 0, c.width, c.height);
          return new Set(new Uint32Array(data.buffer)).size;
        }})()"""
    )


def order(page: Tab, words: str) -> None:
    """Send words from the dialog for a new mission."""
    page.click("#new")
    page.type("#words", words)
    page.click("#new-ok")


def test_the_page_shows_the_state_and_loads_nothing_external(page, house):
    page.says("#english", "bed")
    page.says("#health", "running, ready")
    page.says("#latency", "tick")
    page.says("#log", "target: bed")
    page.until("document.querySelectorAll('#automaton circle').length >= 3")
    assert page.run("document.getElementById('camera2').hidden")
    for canvas in ("map", "camera"):
        page.until(f"document.getElementById('{canvas}').width > 300")
    assert painted(page, "map") > 20
    eventually(lambda: painted(page, "camera") > 100)
    assert {urlsplit(url).netloc for url in page.asked} - {""} == {f"127.0.0.1:{house.port}"}
    assert page.complaints == []


def test_the_page_shows_the_current_startup_step(tab):
    vitals = ServiceHealth(SystemdNotifier({}))
    view = LiveView(simulated({"mission": {"target": "bed"}}), vitals)
    vitals.starting("loading the detector")
    with serve(view.pages(), HERE, 0) as port:
        tab.open(f"http://{HERE}:{port}/")
        tab.says("#banner", "Starting: loading the detector")
        assert tab.text("#phase") == "STARTING"


def test_a_chosen_layer_is_drawn_over_the_map(page):
    page.until("document.getElementById('layer').options.length > 1")
    page.run(
        "(() => { const s = document.getElementById('layer'); s.value = 'looked at';"
        " s.dispatchEvent(new Event('change')); })()"
    )
    page.until(
        # Yellow for well seen cells, over free cells.
        """(() => {
          const c = document.getElementById("map");
          const { data } = c.getContext("2d").getImageData(0, 0, c.width, c.height);
          let n = 0;
          for (let i = 0; i < data.length; i += 4)
            n += data[i] - data[i + 1] < 30 && data[i] - data[i + 2] > 90;
          return n > 200;
        })()"""
    )
    assert page.complaints == []


def test_pause_stops_the_robot_and_resume_continues(page, house):
    page.click("#pause")
    page.says("#phase", "PAUSED")
    page.says("#banner", "Paused: the robot holds its position")
    assert house.service.mission.paused
    assert house.service.goals.goal is None
    page.says("#pause", "Resume")
    page.click("#pause")
    page.says("#phase", "SEARCHING")
    assert not house.service.mission.paused


def test_a_mission_from_the_page_reaches_the_robot(page, house):
    order(page, "find the sofa")
    page.until("!document.getElementById('new-dialog').open")
    page.says("#instruction", "find the sofa")
    assert house.service.mission.spec.targets == ("sofa",)


def test_a_wait_is_shown_and_ends_by_the_button(page, house):
    order(page, 'go to "wait"')
    page.says("#phase", "WAITING")
    page.says("#reason", "now: wait; waiting until told to go on")
    page.says("#pause", "Go on")
    page.click("#pause")
    page.says("#phase", "REACHED")


def test_an_unknown_instruction_is_refused_and_changes_nothing(page, house):
    order(page, INSTRUCTION)
    page.until("!document.getElementById('new-error').hidden")
    assert page.run("document.querySelector('#new-error b')") is None
    assert house.service.mission.spec.targets == ("bed",)


def test_the_page_offers_a_choice_between_readings(page, house):
    order(page, "the sofa must be visited before the bed")
    page.until("document.querySelectorAll('#readings button').length === 3")
    page.says("#new-error", "This can be read in several ways. Which one do you mean?")
    assert house.service.mission.spec.targets == ("bed",)
    page.click("#readings button:last-child")
    page.until("!document.getElementById('new-dialog').open")
    page.says("#formula", "F (sofa & F bed)")
    assert house.service.mission.spec.translation.reading == 3


def test_an_uncertain_reading_is_shown_before_it_starts(page, house):
    order(page, "vist the sofa")
    page.until("document.querySelectorAll('#readings button').length === 1")
    page.says("#new-error", "Is this what you mean?")
    page.says("#readings", "1. Reach the sofa.")
    assert house.service.mission.spec.targets == ("bed",)
    page.click("#readings button")
    page.until("!document.getElementById('new-dialog').open")
    page.says("#formula", "F sofa")


def test_an_idle_robot_starts_a_mission_from_the_page(tab):
    with open_house(mission={"target": "bed", "on_request": True}, robot=SLOWLY) as house:
        tab.open(house.url)
        tab.run(f"sessionStorage.setItem('edge-token', '{TOKEN}')")
        tab.open(house.url)
        tab.says("#phase", "IDLE")
        assert tab.text("#reason") == "waiting for a mission"
        assert "idle" in tab.run("document.title")
        tab.says("#english", "The robot waits for a mission")
        for part in ("#formula", "#automaton", "#plan", "#note"):
            assert tab.text(part) == ""  # the configured mission is not shown
        assert tab.run("document.getElementById('pause').disabled")
        order(tab, "find the sofa")
        tab.says("#formula", "F sofa")
        tab.until("document.getElementById('phase').innerText !== 'IDLE'")
        tab.until("document.querySelectorAll('#automaton circle').length >= 3")


def press(tab: Tab, *ends: tuple[int, int]) -> None:
    """Press the mouse at the first place, and release it at the last."""
    kinds = ("mousePressed", *["mouseMoved"] * (len(ends) - 1), "mouseReleased")
    for kind, (x, y) in zip(kinds, (*ends, ends[-1]), strict=True):
        mouse = {"button": "left", "buttons": 1, "clickCount": 1}
        tab.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **mouse)


def choose(tab: Tab, kind: str, name: str) -> None:
    """Begins to add a place or a zone."""
    tab.run(
        "(() => { const s = document.getElementById('site-kind');"
        f" s.value = '{kind}'; s.dispatchEvent(new Event('change')); }})()"
    )
    tab.type("#site-name", name)
    tab.click("#site-add")


def test_places_and_zones_are_drawn_and_removed(page, house):
    page.says("#site-list", "start")
    choose(page, "here", "dock")
    page.says("#site-list", "dock")
    choose(page, "place", "<b>shelf</b>")  # refused: no name
    press(page, (560, 330))
    page.says("#toast", "letters, digits")
    page.run("document.getElementById('site-name').value = ''")
    choose(page, "place", "shelf")
    page.says("#site-hint", "drag from the place")
    press(page, (560, 330), (560, 280))
    page.says("#site-list", "shelf")
    choose(page, "keep_out", "stairs")
    for corner in ((660, 410), (760, 410), (760, 490)):
        press(page, corner)
    page.says("#site-add", "Done")
    page.click("#site-add")
    page.says("#site-list", "keep out")
    site = house.service.site.site
    assert [item.name for item in site.items] == ["dock", "shelf", "stairs"]
    assert site.place("shelf").pose.yaw_rad == pytest.approx(math.pi / 2)
    (corners_m,) = site.polygons_m("keep_out")
    assert corners_m[1] - corners_m[0] == pytest.approx([corners_m[1][0] - corners_m[0][0], 0])
    page.click("#site-list .place button:last-child")
    page.says("#site-list", "Remove?")
    page.click("#site-list .place button:last-child")
    page.until("!document.querySelector('#site-list').innerText.includes('dock')")
    assert house.service.site.site.place("dock") is None


def test_escape_ends_the_drawing_and_adds_nothing(page, house):
    page.says("#site-list", "start")
    choose(page, "stay_inside", "ground floor")
    press(page, (660, 410))
    page.call("Input.dispatchKeyEvent", type="keyDown", key="Escape")
    page.says("#site-add", "Add")
    assert page.text("#site-hint") == ""
    assert house.service.site.site.items == ()


def test_a_click_into_a_room_names_it(page, house):
    page.until("document.querySelector('#rooms-list button') !== null")
    choose(page, "room", "office")
    page.says("#site-hint", "click into the room")
    page.click("#rooms-list button")  # the map moves, until the room is in its middle
    box = page.run("document.getElementById('map').getBoundingClientRect().toJSON()")
    press(page, (round(box["x"] + box["width"] / 2), round(box["y"] + box["height"] / 2)))
    page.says("#rooms-list", "office")
    page.says("#site-list", "room name")
    assert [one.name for one in house.service.site.site.room_names] == ["office"]
    assert "office" in [room.name for room in house.service.map.rooms.rooms]
    assert page.complaints == []


def test_remembered_objects_are_listed_and_no_markup(page, house):
    house.tasked.objects = [KnownObject(1, INSTRUCTION, (1.0, 2.0, 0.5), 0.625, 3, 61.0)]
    page.says("#objects-note", "Remembered objects (1)")
    page.says("#objects-list", INSTRUCTION)
    page.says("#objects-list", "0.63, 60 s ago")
    assert page.run("document.querySelector('#objects-list b')") is None
    page.click("#objects-list button")
    assert page.complaints == []


def test_the_text_box_starts_a_mission_or_explains_why_not(page, house):
    page.type("#sentence", "find the sofa")
    page.click("#send")
    page.says("#answer", "Started: Reach the sofa.")
    assert house.service.mission.spec.targets == ("sofa",)
    page.type("#sentence", INSTRUCTION)
    page.click("#send")
    page.until("document.getElementById('answer').className === 'error'")
    page.run("document.getElementById('sentence').value = ''")
    page.type("#sentence", "vist the bed")
    page.click("#send")
    page.until("document.getElementById('new-dialog').open")
    page.click("#readings button")
    page.until("!document.getElementById('new-dialog').open")
    page.says("#formula", "F bed")


def test_the_answer_to_a_question_is_shown(page, house, monkeypatch):
    asked = house.view._queues["mission/request"]
    answer = json.dumps({"text": "mug: <b>here</b>"}).encode()
    monkeypatch.setattr(asked, "accept", lambda body, reply: reply(answer, False))
    page.type("#sentence", "where is the mug?")
    page.click("#send")
    page.says("#answer", "mug: <b>here</b>")
    assert page.text("#sentence") == ""


def test_cancelling_takes_two_clicks(page, house):
    page.click("#cancel")
    page.says("#cancel", "Really cancel?")
    assert not house.service.mission.done
    page.click("#cancel")
    page.says("#phase", "FAILED")
    page.says("#reason", "cancelled")
    assert house.service.mission.done


def test_one_click_stops_and_a_release_takes_two(page, house):
    page.click("#stop")
    page.says("#phase", "STOPPED")
    page.says("#banner", "Stopped: button on the page")
    assert house.service.control.stopped
    page.says("#stop", "Release")
    page.click("#stop")
    page.says("#stop", "Really release?")
    assert house.service.control.stopped
    page.click("#stop")
    page.says("#stop", "Stop")
    eventually(lambda: not house.service.control.stopped)


def test_each_button_forgets_its_first_click(page):
    page.click("#stop")
    page.says("#stop", "Release")
    clicked = page.run(
        "['cancel', 'stop'].map((id) => {"
        " const button = document.getElementById(id); button.click(); return button.textContent; })"
    )
    assert clicked == ["Really cancel?", "Really release?"]
    page.says("#cancel", "Cancel")
    page.says("#stop", "Release")


@pytest.mark.parametrize("button", ["Allow", "Deny"])
def test_a_person_allows_or_denies_an_agents_request(tab, button):
    text = "go to the <b>sofa</b>"
    with open_house(mission={"target": "bed", "on_request": True}, mcp={"motion": "ask"}) as house:
        tab.open(house.url)
        tab.run(f"sessionStorage.setItem('edge-token', '{TOKEN}')")
        tab.open(house.url)
        tab.says("#phase", "IDLE")
        instruction = json.dumps({"do": "propose", "instruction": "go to the sofa", "by": text})
        house.view._queues["agent/request"].accept(instruction.encode(), lambda *_: None)
        tab.says("#proposals", f"Agent {text} asks within")
        number = ("Allow", "Deny").index(button) + 1
        tab.click(f"#proposals button:nth-of-type({number})")
        tab.until("document.querySelectorAll('#proposals li').length === 0")
        assert (house.service.mission.ended == "idle") == (button == "Deny")


def test_a_seen_target_is_approached_and_reached(tab):
    nearby = {"start": [3.2, 2.3, 2.0]}
    with open_house(token=None, mission={"target": "sofa"}, sim=nearby) as house:
        tab.open(house.url)
        tab.says("#phase", "REACHED")
        tab.says("#log", "seen: sofa")
        assert house.service.status.phase == "reached"


def test_a_second_camera_has_its_picture_next_to_the_first(tab):
    cameras = {"camera": {"width_px": 80, "height_px": 64},
               "second_camera": {"width_px": 96, "height_px": 64, "yaw_deg": 180.0}}  # fmt: skip
    with open_house(token=None, sensors=cameras) as house:
        tab.open(house.url)
        tab.says("#camera-note", "80 × 64 · 96 × 64")
        for canvas in ("camera", "camera2"):
            eventually(lambda canvas=canvas: painted(tab, canvas) > 20)
        left, right = (
            tab.run(f"document.getElementById('{name}').getBoundingClientRect().{side}")
            for name, side in (("camera", "right"), ("camera2", "left"))
        )
        assert left <= right


def test_missing_sensor_data_are_shown_with_the_reason(page, house):
    page.says("#camera-note", " × ")
    house.robot.blind = True
    page.says("#banner", "Not ready: no usable observations")
    page.says("#camera-note", "no new image for")
    house.robot.blind = False
    page.until("document.getElementById('banner').hidden")


def test_the_missing_input_is_named_in_banner_and_health(page, house):
    inputs = TimeSynchronizer(house.closed.config, lambda: 0).inputs
    for name in ("camera/rgb", "camera/info", "odom"):
        inputs.on_message(name)
    inputs.on_dropped("odom", "malformed", "<b>no odometry</b>")
    house.service.parts_status.inputs = inputs.rows
    house.robot.blind = True
    page.says(
        "#banner", "no usable observations: no message yet on camera/depth; every message on odom"
    )
    page.says("#health", "camera/depth\nno message yet\n")
    page.says("#health", "odom\nall are dropped: malformed (")
    assert page.run("document.querySelectorAll('#banner b, #health b').length") == 0
    house.robot.blind = False


def test_a_degraded_loop_is_shown_with_escaped_text(page, house):
    house.brittle.broken = True
    page.says("#banner", "the loop is degraded")
    page.says("#banner", "<b>broken</b>")
    page.says("#log", "<b>broken</b>")
    assert page.run("document.querySelectorAll('#banner b, #log b, #health b').length") == 0
    house.brittle.broken = False
    page.until("document.getElementById('banner').hidden")


def test_an_error_is_shown_differently_from_no_answer(page, monkeypatch):
    def broken(*args):
        raise ValueError("<b>broken</b>")

    for part, function, phase in (
        ("mission", "log_json", "SEARCHING"),
        ("now", "snapshot_json", "ERROR"),
    ):
        with monkeypatch.context() as breaking:
            breaking.setattr(f"edge.live.view.{function}", broken)
            why = f"/live/{part} failed: ValueError: <b>broken</b>"
            page.says("#banner", f"answered with an error: {why}")
            page.says("#phase", phase)
        page.until("document.getElementById('banner').hidden")
        page.says("#phase", "SEARCHING")


def test_a_service_that_ended_is_shown_as_last_seen(tab):
    with open_house(token=None) as house:
        tab.open(house.url)
        tab.says("#phase", "SEARCHING")
    tab.says("#banner", "does not answer: last seen")
    tab.says("#phase", "NO ANSWER")


def test_without_a_token_nothing_can_be_done(tab):
    with open_house(token=None, robot=SLOWLY) as house:
        tab.open(house.url)
        tab.says("#phase", "SEARCHING")
        for form in ("controls", "site-form", "ask"):
            assert tab.run(f"document.getElementById('{form}').hidden")
        assert "http.token_file" in tab.text("#readonly")


def test_the_page_asks_until_the_token_is_right(tab, house):
    tab.open(house.url)
    tab.run("sessionStorage.clear()")
    tab.open(house.url)
    tab.until("document.getElementById('token-dialog').open")
    assert tab.text("#phase") == "CONNECTING"
    for said, shown in (("a-wrong-one-of-these", False), (TOKEN, True)):
        tab.type("#token", said)
        tab.click("#token-ok")
        if shown:
            tab.says("#phase", "SEARCHING")
        else:
            tab.until("!document.getElementById('token-error').hidden")
    assert TOKEN not in tab.run("document.documentElement.outerHTML")


def test_an_unknown_model_is_refused_in_one_line(page):
    page.type("#model", "no-such-model")
    page.click("#use")
    page.says("#toast", "no-such-model")


def test_dragging_the_map_stops_following_the_robot(page):
    page.click("#follow")
    pressed = "document.getElementById('follow').getAttribute('aria-pressed')"
    assert page.run(pressed) == "true"
    page.click("#zoom-in")
    assert page.run(pressed) == "true"
    mouse = {"button": "left", "buttons": 1, "clickCount": 1}
    for kind, x in (("mousePressed", 300), ("mouseMoved", 360), ("mouseReleased", 360)):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=300, **mouse)
    assert page.run(pressed) == "false"


def test_a_task_replaces_the_mission_on_the_page(page, house):
    house.tasked.task = looking()
    page.says("#phase", "LOOKING")
    page.says("#what", "Task")
    page.says("#asked", TASK)
    page.says("#task-facts", "van, gate")
    assert page.text("#automaton") == page.text("#formula") == ""
    hidden = "document.querySelector('.legend .trajectory').hidden"
    assert page.run(hidden)
    house.tasked.task = driving(60)
    page.says("#phase", "DRIVING")
    page.says("#task-facts", "s in total")
    page.until(f"!{hidden}")
    house.tasked.task = None
    page.says("#what", "Mission")
    page.says("#formula", "F bed")
    page.until("document.getElementById('task').hidden")
    assert page.run(hidden)
    assert page.complaints == []


def test_text_of_a_model_is_escaped_and_fetched_once(page, house):
    house.tasked.task = by_a_model()
    page.says("#rounds", "<script>alert(1)</script>")
    page.says("#rounds", "give_trajectory([(1, 0)])")
    page.run("document.querySelectorAll('#task details').forEach((fold) => (fold.open = true))")
    page.says("#prompt", "<img src=x")
    page.says("#rounds", "the answer has no ```python block")
    assert page.run("document.querySelectorAll('#task script, #task img').length") == 0
    driven = page.text("#task-facts")
    house.tasked.task = by_a_model(index=90)
    page.until(f"document.getElementById('task-facts').innerText !== {json.dumps(driven)}")
    assert sum(url.endswith("/live/task") for url in page.asked) == 1
    assert page.complaints == []


def test_a_task_is_given_from_the_page(page, house):
    page.click("#new")
    page.click("[name=as][value=task]")
    assert "go around" in page.run("document.getElementById('words').placeholder")
    page.type("#words", "go past the left of the sofa")
    page.click("#new-ok")
    page.until("!document.getElementById('new-dialog').open")
    page.says("#asked", "go past the left of the sofa")
    assert house.service.behaviour.task_status() is not None
