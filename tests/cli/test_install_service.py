"""The systemd unit: its content, systemd's own checks of it, and refused installations."""

from __future__ import annotations

import os
import pwd
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from simulated import simulated

from edge.cli import install_service
from edge.cli.install_service import unit
from edge.cli.main import main
from edge.config import Config
from edge.errors import EXIT_CODES, PERMANENT, ConfigError, UserError

MOST_EXPOSED = 2.0
ANALYZE = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed"
)


@pytest.fixture(autouse=True)
def no_signal_handlers(monkeypatch):
    """Commands run in this process must leave its signal handlers alone."""
    monkeypatch.setattr("signal.signal", lambda *_: None)


@pytest.fixture
def anywhere(monkeypatch):
    """Let Python be readable, in any folder that these tests are run from."""
    monkeypatch.setattr(install_service, "_check_readable", lambda paths, user: None)


def settings(path: object = "/etc/edge/robot.yaml", **loop: int) -> Config:
    return simulated({"loop": loop}, str(path))


def lines(text: str, key: str) -> list[str]:
    return [line.partition("=")[2] for line in text.splitlines() if line.startswith(f"{key}=")]


def analyze(verb: str, text: str, folder: Path, *options: str) -> subprocess.CompletedProcess:
    file = folder / "edge-test.service"
    file.write_text(text, encoding="utf-8")
    return subprocess.run(
        ["systemd-analyze", verb, *options, file], capture_output=True, text=True, check=False,
        env={**os.environ, "SYSTEMD_COLORS": "0", "LC_ALL": "C.UTF-8"},
    )  # fmt: skip


def installations() -> list:
    return [
        pytest.param(None, {}, id="a user of systemd's making"),
        pytest.param("daemon", {"priority": 20}, id="daemon, in real time"),
    ]


@ANALYZE
@pytest.mark.parametrize(("user", "loop"), installations())
def test_systemd_verifies_the_unit_without_complaints(user, loop, tmp_path, anywhere):
    done = analyze("verify", unit(settings(**loop), "edge", user), tmp_path)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


@ANALYZE
@pytest.mark.parametrize(("user", "loop"), installations())
@pytest.mark.parametrize("homes", [False, True])
def test_the_unit_has_a_low_exposure_score(user, loop, homes, tmp_path, anywhere):
    config = settings("/home/me/robot.yaml" if homes else "/etc/edge/robot.yaml", **loop)
    text = unit(config, "edge", user)
    done = analyze("security", text, tmp_path, "--offline=yes", "--no-pager")
    if "unrecognized option" in done.stderr:
        pytest.skip("this systemd-analyze cannot look at files (--offline)")
    found = re.search(r"exposure level for edge-test.service: ([\d.]+)", done.stdout)
    assert found is not None, done.stdout + done.stderr
    assert float(found[1]) <= MOST_EXPOSED


def test_the_unit_runs_this_installation_with_its_configuration(anywhere):
    text = unit(settings(), "rover-2", None)
    (command,) = lines(text, "ExecStart")
    assert command == f"{sys.executable} -m edge.cli run /etc/edge/robot.yaml"
    assert lines(text, "DynamicUser") == ["yes"]
    assert lines(text, "User") == []
    assert lines(text, "StateDirectory") == lines(text, "CacheDirectory") == ["rover-2"]
    assert lines(text, "Environment") == ["EDGE_CACHE_DIR=%C/rover-2"]
    # numba compiles, Zenoh shares memory, cameras and GPUs are devices.
    for breaks in ("MemoryDenyWriteExecute", "PrivateIPC", "PrivateDevices"):
        assert breaks not in text


def test_permanent_failures_are_not_restarted(anywhere):
    (codes,) = lines(unit(settings(), "edge", None), "RestartPreventExitStatus")
    assert tuple(map(int, codes.split())) == PERMANENT
    assert set(PERMANENT) < EXIT_CODES.keys()
    page = (Path(__file__).parents[2] / "docs/service.md").read_text(encoding="utf-8")
    assert " ".join(page.split()).count("not after {}, {} and {}".format(*PERMANENT)) == 1


@pytest.mark.parametrize(
    ("priority", "key", "value"), [(0, "RestrictRealtime", "yes"), (20, "LimitRTPRIO", "20")]
)
def test_real_time_rights_need_a_priority(priority, key, value, anywhere):
    assert lines(unit(settings(priority=priority), "edge", None), key) == [value]


@pytest.mark.parametrize(
    ("path", "word"),
    [
        ("/a/b.yaml", "/a/b.yaml"),
        ("/a b/c.yaml", '"/a b/c.yaml"'),
        ("/a%b/$c.yaml", "/a%%b/$$c.yaml"),
        ('/a"b\\.yaml', '"/a\\"b\\\\.yaml"'),
    ],
)
def test_any_path_is_quoted_as_one_word(path, word, anywhere):
    (command,) = lines(unit(settings(path), "edge", None), "ExecStart")
    assert command.endswith(f" run {word}")


def test_groups_that_are_not_here_are_not_asked_for(monkeypatch, anywhere):
    monkeypatch.setattr(install_service.grp, "getgrall", list)
    assert lines(unit(settings(), "edge", None), "SupplementaryGroups") == []


@pytest.fixture
def private(tmp_path, monkeypatch) -> Path:
    """Return a configuration in a folder that only its owner can read, not a temporary one."""
    monkeypatch.setattr(install_service, "_TEMPORARY", ())
    folder = tmp_path / "mine"
    folder.mkdir(mode=0o700)
    file = folder / "robot.yaml"
    file.write_text("perception: {detector: {kind: sim}}")
    return file


def test_a_configuration_unreadable_to_the_service_user_is_refused(private):
    with pytest.raises(
        UserError,
        match=r"cannot be read by the user that systemd creates.*; put it where all "
        r"users can.*--user",
    ) as caught:
        unit(settings(private), "edge", None)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ("executable", "^the Python of this environment, {}: .* make the environment with"),
        ("base_prefix", "^the Python of this environment, {}: .* make the environment with"),
        ("PACKAGE", "^the package, {}: .* install it where all users can read it"),
    ],
)
def test_unreadable_parts_of_the_installation_are_reported(private, monkeypatch, what, says):
    """A pyenv's Python is in a home, even if the environment that is linked to it is not."""
    file = private.parent / "python3"
    file.touch()
    link = private.parent.parent / "link"
    link.symlink_to(file)
    private.parent.parent.chmod(0o755)
    owner = install_service.resources if what == "PACKAGE" else sys
    monkeypatch.setattr(install_service, "_may_read", lambda path, *_: path != private.parent)
    monkeypatch.setattr(owner, what, link if what == "PACKAGE" else str(link))
    with pytest.raises(UserError, match=says.format(file)) as caught:
        unit(settings("/etc/hostname"), "edge", None)
    assert f", who cannot enter {private.parent}; " in str(caught.value)
    assert "--user" in str(caught.value)


def test_a_configuration_in_tmp_is_refused(private, monkeypatch):
    me = pwd.getpwuid(os.getuid()).pw_name
    monkeypatch.setattr(install_service, "_TEMPORARY", (str(private.parent),))
    with pytest.raises(UserError, match=r"robot.yaml: the service has its own /tmp"):
        unit(settings(private), "edge", me)


def test_an_unknown_user_is_refused():
    with pytest.raises(UserError, match=r"^--user: no user 'no-such-user' on this machine; "):
        unit(settings(), "edge", "no-such-user")


@pytest.fixture
def secure(tmp_path) -> dict[str, dict]:
    """Sections that name files with secrets, which are there."""
    for name in ("service.key", "users.txt", "ca.crt", "http.token"):
        (tmp_path / name).touch(0o600)
    (tmp_path / "service.json5").write_text(f"""{{transport: {{
      link: {{tls: {{listen_private_key: "{tmp_path}/service.key",
                     root_ca_certificate: "{tmp_path}/ca.crt"}}}},
      auth: {{usrpwd: {{dictionary_file: "{tmp_path}/users.txt"}}}},
    }}}}""")
    return {
        "zenoh": {"file": str(tmp_path / "service.json5")},
        "http": {"token_file": str(tmp_path / "http.token")},
    }


@ANALYZE
def test_secrets_are_handed_over_and_stay_roots(secure, tmp_path, anywhere):
    text = unit(simulated(secure, "/etc/edge/robot.yaml"), "edge", None)
    assert lines(text, "LoadCredential") == [
        f"listen_private_key:{tmp_path}/service.key",
        f"dictionary_file:{tmp_path}/users.txt",
        f"http.token_file:{tmp_path}/http.token",
    ]
    done = analyze("verify", text, tmp_path)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_only_files_that_are_not_secret_must_be_readable(secure, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(install_service, "_check_readable", lambda paths, user: asked.extend(paths))
    unit(simulated(secure, "/etc/edge/robot.yaml"), "edge", None)
    assert {tmp_path / "ca.crt", tmp_path / "service.json5"} < set(asked)
    assert not {tmp_path / "service.key", tmp_path / "http.token"} & set(asked)


def test_a_zenoh_file_with_a_password_is_handed_over_itself(tmp_path, anywhere):
    file = tmp_path / "client.json5"
    file.write_text('{transport: {auth: {usrpwd: {user: "me", password: "pw"}}}}')
    config = simulated({"zenoh": {"file": str(file), "mode": "client"}}, "/etc/edge/robot.yaml")
    assert lines(unit(config, "edge", None), "LoadCredential") == [f"zenoh.file.json5:{file}"]


def test_relative_paths_are_the_services_own(secure, anywhere):
    secure["zenoh"] = {"file": "service.json5"}
    with pytest.raises(ConfigError, match=r"^zenoh.file: /var/lib/edge/service.json5: no such"):
        unit(simulated(secure, "/etc/edge/robot.yaml"), "edge", None)


def test_a_missing_secret_is_named(secure, tmp_path, anywhere):
    (tmp_path / "http.token").unlink()
    with pytest.raises(UserError, match=r"^http.token_file: .*http.token: no such file"):
        unit(simulated(secure, "/etc/edge/robot.yaml"), "edge", None)


@pytest.mark.parametrize(
    ("checkpoint", "is_taken"),
    [("mission.json", True), ("/var/lib/edge/mission.json", True), ("/data/mission.json", False)],
)
def test_the_checkpoint_must_be_in_the_services_state_folder(checkpoint, is_taken, anywhere):
    config = simulated({"mission": {"checkpoint": checkpoint}}, "/etc/edge/robot.yaml")
    if is_taken:
        unit(config, "edge", None)
        return
    with pytest.raises(UserError, match=r"^mission.checkpoint: /data.*only below /var/lib/edge"):
        unit(config, "edge", None)


def test_the_command_writes_the_unit_and_prints_the_next_step(private, tmp_path, capsys):
    me, out = pwd.getpwuid(os.getuid()).pw_name, tmp_path / "edge.service"
    words = ["run", "--install", str(private), "--user", me, "--out"]
    assert main([*words, str(out)]) == 0
    said = capsys.readouterr().out
    assert "systemctl enable --now edge" in said
    assert "models list" not in said, "the simulator's detector is no model"
    assert main([*words, "-"]) == 0
    assert capsys.readouterr().out == out.read_text()
    assert str(private) in out.read_text()


@pytest.mark.parametrize("name", ["", "../x", "a b", "-x", "a%i"])
def test_a_name_that_no_unit_may_have_is_refused(name, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["run", "--install", "demo", f"--name={name}"])
    assert caught.value.code == os.EX_USAGE
