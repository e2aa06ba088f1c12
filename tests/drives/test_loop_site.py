"""Places and zones in the running service, in a simulated house."""

from __future__ import annotations

import pytest
from small_house import BOX, HOUSE, driven

from edge.bus.verbs import Request, read_request
from edge.errors import UserError
from edge.geometry import SE2
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.requests.site_requests import SITE_VERBS, handle_site
from edge.memory import Place, Site, Zone
from edge.mission.destinations import PlaceTarget
from edge.mission.spec import prepare

START = (1.6, 1.4)  # of the robot in the built-in house
FAR = Place("dock", SE2(4.0, 2.0, 1.57))


def square(x_m: float, y_m: float, half_m: float) -> tuple[tuple[float, float], ...]:
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return tuple((x_m + a * half_m, y_m + b * half_m) for a, b in corners)


def ask(loop: ClosedLoop, payload: str) -> dict:
    do, fields = read_request(payload.encode(), SITE_VERBS)
    return handle_site(loop.service, Request(do, fields), 0)


@pytest.fixture(scope="module")
def there_and_back() -> ClosedLoop:
    return driven("go to the dock and come back", FAR)


def test_the_robot_drives_to_a_place_and_back(there_and_back):
    loop = there_and_back
    assert loop.service.status.phase == "reached", loop.notes.events
    assert loop.service.mission.sets.reached == ("dock", "here")
    assert loop.drive.motion.pose.distance_to(*START) < 0.5
    kinds = [goal.kind for goal in loop.notes.goals]
    assert kinds[-1] == "place"
    at_dock = next(goal for goal in loop.notes.goals if goal.kind == "place")
    assert at_dock.pose.distance_to(4.0, 2.0) < 0.5
    assert at_dock.pose.yaw_rad == pytest.approx(1.57)
    assert loop.service.mission.destinations["here"].pose.distance_to(*START) < 0.1


def test_a_place_is_named_listed_used_and_removed(there_and_back):
    loop = there_and_back
    names = [f["properties"]["name"] for f in ask(loop, '{"do": "list"}')["site"]["features"]]
    assert names == ["dock", "start"]
    answer = ask(loop, '{"do": "set", "name": "The Charger"}')
    assert answer["text"].startswith("place: charger is (")
    here = loop.service.site.site.place("charger")
    assert here.pose.distance_to(*START) < 0.5
    mission = loop.config.mission
    spec = prepare(mission, "go to the charger", site=loop.service.site.known)
    assert spec.translation.destinations == {"charger": PlaceTarget(here.pose)}
    assert ask(loop, '{"do": "remove", "name": "charger"}')["text"] == "removed: charger"
    with pytest.raises(UserError, match="no place or zone 'charger'"):
        ask(loop, '{"do": "remove", "name": "charger"}')


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        ('{"do": "set"}', "do: set needs a name"),
        ('{"do": "set", "name": ""}', "name: expected text"),
        ('{"do": "set", "name": "a", "feature": {}}', "do: set needs a name"),
        ('{"do": "set", "feature": {"type": "Feature"}}', "feature: properties: Field required"),
        ('{"do": "import", "site": 3}', "site: Input should be a valid dictionary"),
        ('{"do": "remove"}', "name: expected text"),
        (
            '{"do": "set", "feature": {"type": "Feature", "properties": {"kind": "keep_out", '
            '"name": "a"}, "geometry": {"type": "Polygon", "coordinates": [[[5, 5], [6, 5], '
            "[5, 5]]]}}}",
            "zone a: give at least three different corners",
        ),
    ],
)
def test_an_invalid_site_request_is_refused(payload, message):
    with pytest.raises(ValueError, match=message):
        read_request(payload.encode(), SITE_VERBS)


def test_a_place_that_cannot_be_reached_fails_with_the_reason(tmp_path):
    loop = driven("go to the roof", Place("roof", SE2(60.0, 60.0, 0.0)), folder=tmp_path)
    status = loop.service.status
    assert status.phase == "failed"
    assert "no path to roof" in status.reason


@pytest.mark.parametrize(
    "at_m", [START, (START[0] + 1.07, START[1])], ids=["in the middle", "at the edge"]
)
def test_the_robot_leaves_a_zone_that_it_starts_in(at_m):
    loop = driven("go to the dock", FAR, Zone("rug", "keep_out", square(*at_m, 0.8)))
    assert "inside a zone: leaving it by the shortest way" in loop.notes.events
    assert "left the zone" in loop.notes.events
    assert loop.service.status.phase == "reached"


def test_the_robot_stays_inside_a_zone():
    loop = driven("find the bed", Zone("area", "stay_inside", square(*START, 1.5)))
    assert loop.service.status.phase == "failed"
    pose = loop.drive.motion.pose
    assert max(abs(pose.x_m - START[0]), abs(pose.y_m - START[1])) < 1.5 - 0.2


def test_the_robot_explores_the_house_and_comes_back(tmp_path):
    loop = driven("explore the house, then come back", folder=tmp_path)
    assert loop.service.status.phase == "reached", loop.notes.events
    area_m2 = BOX[2][0] * BOX[2][1]
    assert loop.service.map.grid.known_m2 > 0.9 * area_m2
    assert "reached: explored" in " ".join(loop.notes.events)
    assert loop.drive.motion.pose.distance_to(*HOUSE["start"][:2]) < 0.6


def test_a_jump_of_odometry_drops_places_and_zones():
    loop = driven("go to the dock", FAR, Zone("mat", "keep_out", square(9.0, 9.0, 0.3)), seconds=1)
    loop.service.on_pose_jump(0)
    assert loop.service.site.known == Site()
    assert not loop.service.map.grid.zones.any
