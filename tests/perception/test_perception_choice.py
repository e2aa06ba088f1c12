"""Letters on images, and a chat server's answers about them (ViTL eq. 4 to 6)."""

from __future__ import annotations

import base64
import itertools
import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from chat_server import likeliest, send, serving
from hypothesis import given
from hypothesis import strategies as st
from patience import PATIENCE_S

from edge.chat import ChatError
from edge.config import ChoiceOpenai, ChoiceText
from edge.geometry import SE2, CameraModel, se3, to_optical
from edge.perception.runtime.model_file import ModelError
from edge.perception.scoring.choice import server as scorer
from edge.perception.scoring.choice.picture import draw, place_discs, visible_marks
from edge.perception.scoring.choice.question import (
    MAX_MARKS,
    DetectedObject,
    FrontierChoice,
    Mark,
    MarkedView,
    describe,
    direction_question,
    scene_question,
)
from edge.perception.scoring.choice.server import make_server_scorer
from edge.perception.scoring.vlm.answers import MISSING_NATS, probabilities
from edge.types import Observation

LOG_HALF, LOG_QUARTER = math.log(0.5), math.log(0.25)
FLOOR = 0.25 * math.exp(-MISSING_NATS)


# -- letters ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tokens", "answers", "expected"),
    [
        ({"A": -3.0}, "A", [1.0]),
        ({"A": LOG_HALF, "B": LOG_QUARTER}, "AB", [2 / 3, 1 / 3]),
        ({"B": LOG_HALF, " B": LOG_QUARTER, "▁A": LOG_QUARTER}, "AB", [0.25, 0.75]),
        ({"A": LOG_HALF, "a": -0.1, "B": LOG_HALF}, "AB", [0.5, 0.5]),  # an article, no answer
        ({"A": LOG_HALF, "I": -0.1, "B": LOG_HALF}, "AB", [0.5, 0.5]),
        ({"A": LOG_HALF, "x": LOG_QUARTER}, "AB", [0.5 / (0.5 + FLOOR), FLOOR / (0.5 + FLOOR)]),
        ({"yes": LOG_HALF, "NO": LOG_HALF, "Yes": LOG_QUARTER}, ["Yes", "No"], [0.6, 0.4]),
        ({"A": math.log(0.99)}, "ABCDE", [0.99, *[0.01 / 4] * 4]),  # they share the rest
        ({"A": LOG_HALF, " A": LOG_HALF}, "AB", [1.0, 0.0]),
    ],
)
def test_softmax_is_over_exactly_the_answers(tokens, answers, expected):
    p = probabilities(list(tokens.items()), answers)
    assert p.dtype == np.float32
    np.testing.assert_allclose(p, expected, rtol=1e-5, atol=1e-8)


# -- marks ------------------------------------------------------------------------------------


def marks_of(observation, *xy_m, **kw):
    points = np.array(xy_m, np.float32).reshape(-1, 2)
    return visible_marks(observation, points, np.arange(10, 10 + len(points)), **kw)


def test_no_frontiers_or_no_camera_no_marks(make_observation):
    assert marks_of(make_observation()) == ()
    seen = make_observation()
    object.__setattr__(seen, "camera", None)
    assert marks_of(seen, (3.0, 0.0)) == ()


def test_a_ray_through_a_mark_hits_its_frontier():
    """Also for a camera that is turned, pitched and off the robot's middle."""
    camera = CameraModel.from_hfov(80, 64, 1.3)
    T_base_camera = to_optical(se3(0.1, 0.2, 0.6, pitch_rad=0.3))
    T_map_base = SE2(2.0, -1.0, 0.7).matrix(z_m=0.4)
    seen = Observation(0, 0, T_map_base, camera=camera, T_base_camera=T_base_camera)
    points = np.random.default_rng(0).uniform(-6, 6, (300, 2))
    marks = visible_marks(seen, points, np.arange(300), limit=300)
    assert len(marks) > 10
    T = T_map_base @ T_base_camera
    for mark in marks:
        ray = [(mark.u_px - camera.cx_px) / camera.fx_px, (mark.v_px - camera.cy_px) / camera.fy_px]
        direction = T[:3, :3] @ [*ray, 1.0]
        at = T[:3, 3] + direction * (0.4 - T[2, 3]) / direction[2]
        np.testing.assert_allclose(at[:2], points[mark.id], atol=1e-6)
        pose = seen.pose
        assert mark.bearing_rad == pytest.approx(pose.bearing_to(*at[:2]), abs=1e-6)


@pytest.mark.parametrize(
    "xy_m",
    [(-3.0, 0.0), (0.05, 0.0), (0.9, 0.0), (2.0, 3.0), (2.0, -3.0), (0.0, 2.0)],
    ids=["behind", "under the camera", "below the image", "left", "right", "abeam"],
)
def test_a_frontier_outside_the_image_has_no_mark(make_observation, xy_m):
    assert marks_of(make_observation(), xy_m) == ()


@pytest.mark.parametrize(
    ("depth_m", "seen"),
    [
        (np.nan, True),
        (0.0, True),
        (1.0, False),
        (2.2, False),
        (2.5, True),
        (3.0, True),
        (9.0, True),
    ],
)
def test_an_obstacle_in_front_of_a_frontier_hides_it(make_observation, depth_m, seen):
    depth = np.full((64, 80), depth_m, np.float32)
    assert bool(marks_of(make_observation(depth_m=depth), (3.0, 0.0))) == seen


def test_letters_go_from_left_to_right_to_the_nearest(make_observation):
    ring = [(4.0 + 0.1 * i, y) for i, y in enumerate(np.linspace(-1.5, 1.5, 12))]
    marks = marks_of(make_observation(), (2.5, 0.0), *ring)
    assert len(marks) == MAX_MARKS
    assert [m.u_px for m in marks] == sorted(m.u_px for m in marks)
    assert max(m.distance_m for m in marks) < 4.9
    assert 10 in {m.id for m in marks}
    assert marks_of(make_observation(), *ring, limit=1)[0].distance_m == pytest.approx(
        4.27, abs=0.1
    )


# -- pictures ---------------------------------------------------------------------------------


def mark(u_px, v_px, id=0):
    return Mark(id, u_px, v_px, 0.0, 1.0)


@pytest.mark.parametrize(
    ("hw", "max_px", "size"),
    [
        ((256, 320), 640, (256, 320)),
        ((64, 80), 640, (256, 320)),  # enlarged, or letters would hide everything
        ((960, 1280), 640, (480, 640)),
        ((1000, 10), 100, (100, 1)),
        ((64, 80), 64, (51, 64)),
    ],
)
def test_letters_are_drawn_on_a_copy_of_bounded_size(hw, max_px, size):
    rgb = np.full((*hw, 3), 90, np.uint8)
    image, marks = draw(rgb, [mark(hw[1] / 2, hw[0] / 2)], max_px)
    assert image.shape == (*size, 3)
    assert (rgb == 90).all()
    assert len(marks) == (min(size) > 14)
    if marks:
        disc = image[size[0] // 2 - 5 : size[0] // 2 + 6, size[1] // 2 - 5 : size[1] // 2 + 6]
        assert (disc == 255).any()
        assert (disc < 60).any()


@given(
    st.lists(st.tuples(st.floats(-50, 700), st.floats(-50, 500)), max_size=MAX_MARKS),
    st.integers(40, 640),
    st.integers(40, 480),
    st.integers(7, 20),
)
def test_letters_never_overlap_or_leave_the_image(spots, width, height, radius):
    places = place_discs(spots, (width, height), radius)
    assert len(places) == len(spots)
    found = [at for at in places if at is not None]
    for at, other in itertools.combinations(found, 2):
        assert math.dist(at, other) >= 2 * radius + 1
    for u, v in found:
        assert radius <= u <= width - 1 - radius
        assert radius <= v <= height - 1 - radius


# -- questions --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "letters"),
    [(1, "(A), or explore elsewhere (B)"), (3, "(A, B, C), or explore elsewhere (D)"),
     (8, "(A, B, C, D, E, F, G, H), or explore elsewhere (J)")],
)  # fmt: skip
def test_the_questions_are_the_papers(n, letters):
    assert direction_question(n, "red chair") == (
        f"Among directions {letters}, which should I choose to find a red chair? "
        "Answer with ONLY a single letter."
    )
    assert scene_question("bed") == (
        "Does this view show paths or doorways that could lead to a bed? Answer Yes or No."
    )


def view(make_observation, **arrays):
    marks = (Mark(7, 20.0, 40.0, 0.5, 2.04), Mark(9, 60.0, 40.0, -0.1, 4.0))
    seen = (DetectedObject("bed", 0.21, 1.0), DetectedObject("tv", -0.3, 3.25))
    return MarkedView(make_observation(seq=3, **arrays), "lamp", marks, seen)


def test_a_view_in_words(make_observation):
    shown = view(make_observation)
    assert describe(shown) == (
        "The robot sees:\n- bed, left, 1.0 m\n- tv, right, 3.2 m\n"
        "It can go on in these directions:\n- A: left, 2.0 m\n- B: ahead, 4.0 m"
    )
    empty = MarkedView(shown.observation, "lamp", shown.marks)
    assert describe(empty).startswith("The robot sees:\n- nothing that it knows\nIt can")


def test_the_value_of_a_frontier_is_scene_times_direction():
    choice = FrontierChoice(0, "bed", (1, 2), np.array([0.5, 0.25], np.float32), 0.25, 0.4)
    np.testing.assert_allclose(choice.value, [0.2, 0.1])


# -- servers ----------------------------------------------------------------------------------

DIRECTIONS = {"A": LOG_HALF, "B": LOG_QUARTER, "C": LOG_QUARTER, "The": -9.0}
SCENE = {"Yes": LOG_QUARTER, "No": LOG_HALF, " yes": LOG_QUARTER}


def scorer_of(server, kind="openai", **settings):
    make = ChoiceOpenai if kind == "openai" else ChoiceText
    return make_server_scorer(make(url=server.url, model="vlm", **settings))


def put_to(asks, question):
    return asks.answer(asks.prepare(question))


def model(direction=DIRECTIONS, scene=SCENE):
    """Serve a model that answers the two questions in turn."""
    answers = itertools.cycle([direction, scene])
    return lambda handler: send(handler, likeliest(next(answers)))


@pytest.mark.parametrize("kind", ["openai", "text"])
def test_both_questions_make_a_choice(make_observation, kind):
    rgb = np.full((64, 80, 3), 90, np.uint8)
    with serving(model()) as server:
        asks = scorer_of(server, kind)
        choice = put_to(asks, view(make_observation, rgb=rgb))
    assert asks.name == f"vlm at {server.url}"
    assert (choice.stamp_ns, choice.target) == (300_000_000, "lamp")
    assert choice.ids == (7, 9)
    np.testing.assert_allclose(choice.p, [0.5, 0.25], rtol=1e-5)
    assert choice.elsewhere == pytest.approx(0.25)
    assert choice.scene == pytest.approx(0.5)
    np.testing.assert_allclose(choice.value, [0.25, 0.125], rtol=1e-5)


def test_the_image_is_sent_with_its_letters(make_observation):
    rgb = np.full((64, 80, 3), 90, np.uint8)
    with serving(model()) as server:
        asks = scorer_of(server, max_image_px=160)
        put_to(asks, view(make_observation, rgb=rgb))
        with pytest.raises(ModelError, match="observation 3 has no camera image"):
            asks.prepare(view(make_observation))
    image, text = server.requests[0][2]["messages"][1]["content"]
    assert image["type"] == "image_url"
    data = base64.b64decode(image["image_url"]["url"].split(",")[1])
    sent = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert sent.shape == (128, 160, 3)
    assert (sent > 240).any()
    assert text == {"type": "text", "text": direction_question(2, "lamp")}


def test_without_a_mark_or_room_for_its_letter_nothing_is_asked(make_observation):
    with serving(model()) as server:
        question = view(make_observation, rgb=np.zeros((4, 80, 3), np.uint8))
        assert put_to(scorer_of(server, max_image_px=80), question) is None
        unmarked = MarkedView(question.observation, "lamp", ())
        assert put_to(scorer_of(server), unmarked) is None
    assert server.requests == []


@pytest.mark.parametrize(
    ("behave", "expected"),
    [
        (
            model(direction={"The": -0.1, "I": -2.0}),
            "begins its answer with 'The', 'I', not with A",
        ),
        (model(scene={"Maybe": -0.1}), "begins its answer with 'Maybe', not with Yes, No"),
        (model(scene={}), "no logprobs"),
        (lambda handler: send(handler, b"", 500), "HTTP 500"),
    ],
)
def test_an_invalid_answer_is_an_error_of_one_line(make_observation, behave, expected):
    with serving(behave) as server:
        asks = scorer_of(server, "text", time_limit_s=PATIENCE_S)
        with pytest.raises(ChatError) as raised:
            put_to(asks, view(make_observation))
    assert str(raised.value).startswith(server.url)
    assert expected in str(raised.value)
    assert str(raised.value).isprintable()


def test_the_time_limit_is_for_both_questions(make_observation, monkeypatch):
    made = make_server_scorer(ChoiceText(url="http://127.0.0.1:1/v1", model="m", time_limit_s=5.0))
    clock = itertools.count(100.0, 2.0)
    monkeypatch.setattr(scorer, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    left = []

    def next_tokens(messages, left_s):
        left.append(left_s)
        return [("A", -1.0), ("Yes", -1.0)]

    monkeypatch.setattr(made._model._client, "next_tokens", next_tokens)
    put_to(made, view(make_observation))
    assert left == [3.0, 1.0]


@pytest.mark.parametrize("url", ["", "localhost:8080", "ftp://host/v1", "http://user:pw@host/v1"])
def test_an_unusable_url_is_refused_at_once(url):
    with pytest.raises(ChatError, match=r"^perception\.choice: .*http://HOST:PORT/v1"):
        make_server_scorer(ChoiceText(url=url, model="m"))
