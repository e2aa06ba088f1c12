"""Places and zones of a running service, by command: `edge place` and `edge zone`."""

from __future__ import annotations

import json
import os

from edge_processes import LOCKED, write_config
from live_patience import eventually


def test_places_and_zones_by_command(edge, endpoint, tmp_path, command):
    kept = tmp_path / "site.geojson"
    config = write_config(
        tmp_path, zenoh={"endpoint": endpoint}, source={"kind": "zenoh", "localised": True},
        mission={"target": "toilet", "site": str(kept)}, **LOCKED,
    )  # fmt: skip
    service = edge("run", config)
    service.says("ready:")
    code, said = command("place", "set", config, "dock")
    assert (code, "pose is not known yet" in said) == (os.EX_DATAERR, True), said
    code, said = command("place", "set", config, "shelf", "--at=-1.5,2,90")
    assert (code, said) == (0, "place: shelf is (-1.50, 2.00)\n")
    code, said = command("zone", "keep-out", config, "stairs", "5,5", "6,5", "6,6")
    assert (code, said) == (0, "zone: keep out of stairs (3 corners)\n")
    edge("sim", config)
    eventually(lambda: command("place", "set", config, "the dock")[0] == 0)
    code, said = command("place", "list", config)
    assert [line.split(" is ")[0] for line in said.splitlines()] == [
        "place: shelf", "zone: keep out of stairs (3 corners)", "place: dock", "place: start",
    ]  # fmt: skip
    exported = tmp_path / "out.geojson"
    assert command("place", "export", config, str(exported))[0] == 0
    code, said = command("place", "export", config, str(tmp_path / "out.geojson" / "file"))
    assert (code, "out.geojson/file: cannot be written" in said) == (os.EX_IOERR, True), said
    code, said = command("zone", "keep-out", config, "line", "5,5", "6,5")
    assert (code, "at least three different corners" in said) == (os.EX_DATAERR, True), said
    assert command("zone", "remove", config, "stairs") == (0, "removed: stairs\n")
    code, said = command("zone", "remove", config, "stairs")
    assert (code, "no place or zone 'stairs'" in said) == (os.EX_DATAERR, True)
    code, said = command("place", "import", config, str(exported), "--replace")
    assert code == 0, said
    code, said = command("place", "list", config, "--json")
    assert json.loads(said) == json.loads(exported.read_text())
    code, said = command("mission", "new", config, "go to the shelf, then to the dock")
    assert code == 0, said
    eventually(lambda: "dock" in kept.read_text())
    # The robot knows only the places that it has seen; by then it may have seen something.
    code, said = command("memory", "find", config, "unicorn")
    assert (code, said) == (1, "no unicorn has been seen: the detector is not looking for it\n")
    eventually(lambda: command("memory", "list", config)[1] != "none\n")
    code, said = command("memory", "list", config, "--json")
    name = json.loads(said)[0]["name"]
    code, said = command("memory", "find", config, name)
    assert (code, said.startswith(f"{name}: "), "at (" in said) == (0, True, True), said
    assert command("memory", "export", config, str(exported))[0] == 0
    assert {"id", "name", "xyz"} <= json.loads(exported.read_text())[0].keys()
    assert command("memory", "export", config, str(exported), "--geojson")[0] == 0
    kinds = [one["properties"]["kind"] for one in json.loads(exported.read_text())["features"]]
    assert {"place", "object"} <= set(kinds)
    code, said = command("memory", "export", config, str(exported / "file"))
    assert (code, "cannot be written" in said) == (os.EX_IOERR, True), said
    code, said = command("place", "import", config, str(tmp_path / "none"))
    assert (code, "no such file" in said) == (os.EX_DATAERR, True)
