"""`edge run --install`: writes a systemd unit with the paths, user and groups of this installation.

The unit is hardened as far as possible. Not set are `MemoryDenyWriteExecute` (numba compiles code),
`PrivateIPC` (Zenoh's shared memory), `PrivateDevices` (cameras, GPUs), `PrivateUsers` (groups would
have no effect) and `ProcSubset=pid` (no CPU would be found).

Files with secrets can stay readable for root alone: systemd gives the service copies of them
(`LoadCredential=`, `edge.host.credentials`).
"""

from __future__ import annotations

import argparse
import grp
import os
import pwd
import stat
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from edge.bus.zenoh_file import certificates, read_zenoh_file, secrets
from edge.config import Config, DetectorOnnx, load
from edge.errors import PERMANENT, UnavailableError, UserError
from edge.host import resources
from edge.host.files import save
from edge.loop.monitoring.service_health import HANGS_S

UNITS = Path("/etc/systemd/system")  # has the units of the administrator
STATE = Path("/var/lib")  # has the working folder of the service
DYNAMIC_USER = "that systemd creates"
"""Description of a dynamic user, for errors."""
_GROUPS = ("video", "render")  # they may use cameras and GPUs
_HOMES = ("/home", "/root", "/run/user")
_TEMPORARY = ("/tmp", "/var/tmp")  # PrivateTmp gives the service its own
# Errors for paths that the service's user cannot read: (name of the path, what to do).
_PYTHON_ERROR = (
    "the Python of this environment, {}",
    "make the environment with a Python that all users can read (such as "
    "/usr/bin/python3 -m venv /opt/edge)",
)
_PACKAGE_ERROR = "the package, {}", "install it where all users can read it (such as /opt/edge)"
_OTHER_ERROR = "{}", "put it where all users can read it (such as /opt)"
_DEVICES = (
    "char-nvidia", "char-nvidia-uvm", "/dev/nvmap", "/dev/nvhost-ctrl", "/dev/nvhost-ctrl-gpu",
    "/dev/nvhost-gpu", "/dev/nvhost-as-gpu", "/dev/nvhost-prof-gpu", "char-drm",
    "char-video4linux",
)  # fmt: skip

_UNIT = """\
# Written by `edge run --install`: run it again after moving files. Change with `systemctl edit`.
[Unit]
Description=edge: vision-language navigation ({name})
Wants=network-online.target
After=network-online.target
StartLimitIntervalSec=300
StartLimitBurst=10

[Service]
Type=notify
ExecStart={command}
ExecReload=/bin/kill -HUP $MAINPID
EnvironmentFile=-/etc/default/{name}
Environment=EDGE_CACHE_DIR=%C/{name}
StateDirectory={name}
CacheDirectory={name}
WorkingDirectory=%S/{name}
{user}
TimeoutStopSec=30
WatchdogSec={watchdog_s:g}
# Writes the stack of every thread to the journal, before SIGKILL.
WatchdogSignal=SIGUSR1
TimeoutAbortSec=2
Restart=on-failure
RestartSec=2
RestartPreventExitStatus={no_restart}
{real_time}

NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
UMask=0077
ProtectSystem=strict
ProtectHome={homes}
PrivateTmp=yes
PrivateMounts=yes
ProtectProc=invisible
ProtectClock=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectControlGroups=yes
LockPersonality=yes
RestrictNamespaces=yes
RestrictSUIDSGID=yes
KeyringMode=private
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallFilter=~@privileged
SystemCallErrorNumber=EPERM
DevicePolicy=closed
{devices}

[Install]
WantedBy=multi-user.target
"""


def run(args: argparse.Namespace) -> int:
    """Handle `edge run --install CONFIG`.

    Raises:
        ConfigError: the configuration cannot be used.
        UserError: the user does not exist, or cannot read or write a file of the configuration.
        FileError: the unit cannot be written.
    """
    config = load(args.config)
    config = config.model_copy(update={"path": str(Path(config.path).resolve())})
    name = args.name or "edge"
    text = unit(config, name, args.user)
    if args.out == "-":
        print(text, end="")
        return 0
    out = Path(args.out) if args.out else UNITS / f"{name}.service"
    save(out, text.encode())
    print(f"{out}: written; now run:")
    if isinstance(detector := config.perception.detector, DetectorOnnx):
        cache = f"EDGE_CACHE_DIR=/var/cache/{name}"
        print(f"  sudo {cache} {_edge_command()} models list --check {detector.model}")
    print(f"  sudo systemctl daemon-reload\n  sudo systemctl enable --now {name}")
    return 0


def unit(config: Config, name: str, user: str | None) -> str:
    """Return the text of the unit; its folders below /var/lib and /var/cache have the same name.

    The configuration's `path` must be absolute. Without a user, the unit has a dynamic one of
    systemd (`DynamicUser`).

    Raises:
        UserError: see `run`.
    """
    at = STATE / name
    files, credentials = _files_to_read(config, at)
    here = (Path(config.path), Path(sys.executable), Path(sys.base_prefix), resources.PACKAGE)
    needed = (*here, *files)
    _check_readable(needed, user)
    _check_exist(credentials)
    _check_checkpoint(config, at)
    words = (sys.executable, "-m", "edge.cli", "run", config.path)
    priority = config.loop.priority
    return _UNIT.format(
        name=name,
        command=" ".join(map(_quote_argument, words)),
        user="\n".join([*_user_lines(user), *_credential_lines(credentials)]),
        homes="read-only" if any(_in_a_home(path) for path in needed) else "yes",
        # Twice HANGS_S, so that /healthz reports a hang before systemd kills the service.
        watchdog_s=2 * HANGS_S,
        no_restart=" ".join(map(str, PERMANENT)),
        real_time=f"LimitRTPRIO={priority}" if priority else "RestrictRealtime=yes",
        devices="\n".join(f"DeviceAllow={device} rw" for device in _DEVICES),
    )


def _files_to_read(config: Config, at: Path) -> tuple[list[Path], dict[str, Path]]:
    """Return the files that the service reads: public files, and files with secrets.

    Returns:
        The public files, and (name of the credential → file) for those with secrets.
    """
    key, name = "zenoh.file", config.zenoh.file
    if name is not None:
        name = str(at / resources.expand(name))
    native = read_zenoh_file(key, name)
    secret_files = secrets(native, key, name)
    if config.http.token_file is not None:
        secret_files["http.token_file"] = config.http.token_file
    public_files = certificates(native)
    if name is not None and name not in secret_files.values():
        public_files.append(name)
    return (
        [at / resources.expand(path) for path in public_files],
        {secret: at / resources.expand(path) for secret, path in secret_files.items()},
    )


def _check_exist(credentials: Mapping[str, Path]) -> None:
    """Raise UnavailableError for the first file that systemd could not copy."""
    for secret, path in credentials.items():
        if not os.path.isfile(path):  # unlike Path.is_file, does not raise without permission
            raise UnavailableError(
                f"{secret}: {path}: no such file, or only root can see it; correct the path, or "
                "run with sudo"
            )


def _check_checkpoint(config: Config, at: Path) -> None:
    """Raise UserError if the service cannot write its checkpoint."""
    checkpoint = config.mission.checkpoint
    if checkpoint is not None and not (at / resources.expand(checkpoint)).is_relative_to(at):
        raise UserError(
            f"mission.checkpoint: {checkpoint}: the service can write only below {at}; "
            "give a path relative to this folder"
        )


def _user_lines(user: str | None) -> list[str]:
    """Return the lines of the unit that set user and groups."""
    lines = ["DynamicUser=yes"] if user is None else [f"User={user}"]
    # A group that this machine does not have would make the start fail.
    known = {group.gr_name for group in grp.getgrall()}
    if groups := [group for group in _GROUPS if group in known]:
        lines.append(f"SupplementaryGroups={' '.join(groups)}")
    return lines


def _credential_lines(credentials: Mapping[str, Path]) -> list[str]:
    return [
        f"LoadCredential={name}:{path}".replace("%", "%%") for name, path in credentials.items()
    ]


def _quote_argument(text: str) -> str:
    """Return a word of `ExecStart=`, quoted and escaped."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{escaped}"' if any(c in " \t'\"\\;" for c in text) else escaped


def _edge_command() -> str:
    script = Path(sys.executable).with_name("edge")
    return str(script) if script.exists() else f"{sys.executable} -m edge.cli"


def _in_a_home(path: Path) -> bool:
    return _is_below(path, _HOMES) or _is_below(path.resolve(), _HOMES)


def _is_below(path: Path, folders: Iterable[str]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)


def _check_readable(paths: tuple[Path, ...], user: str | None) -> None:
    """Raise UserError for the first path that the user of the service cannot read.

    The user must also be able to enter every folder above the path, and above the file that a
    link points to.
    """
    uid, gids = None, frozenset[int]()
    if user is not None:
        try:
            found = pwd.getpwnam(user)
        except KeyError:
            raise UserError(
                f"--user: no user {user!r:.80} on this machine; create the user, or give another"
            ) from None
        uid, gids = found.pw_uid, frozenset(os.getgrouplist(user, found.pw_gid))
    instead = (
        "or run the service as yourself with --user" if user is None else f"or let {user} read it"
    )
    for path in paths:
        for place in (path, path.resolve()):
            if _is_below(place, _TEMPORARY):
                raise UserError(
                    f"{place}: the service has its own /tmp and cannot read this file; move it "
                    "elsewhere"
                )
            for step in (*place.parents, place):
                if not _may_read(step, uid, gids):
                    named, todo = _name_and_remedy(path)
                    why = "" if step == place else f", who cannot enter {step}"
                    raise UserError(
                        f"{named.format(place)}: cannot be read by the user "
                        f"{user or DYNAMIC_USER}{why}; "
                        f"{todo}, {instead}"
                    )


def _name_and_remedy(path: Path) -> tuple[str, str]:
    """Return the name of an unreadable path, and what to do, for an error."""
    if path in (Path(sys.executable), Path(sys.base_prefix)):
        return _PYTHON_ERROR
    return _PACKAGE_ERROR if path == resources.PACKAGE else _OTHER_ERROR


def _may_read(path: Path, uid: int | None, gids: frozenset[int]) -> bool:
    """Return True if a file can be read, or a folder entered, by its mode bits alone."""
    try:
        found = path.stat()
    except OSError as error:
        raise UnavailableError(
            f"{path}: cannot be read: {error.strerror}; check the path"
        ) from None
    need = stat.S_IXOTH if stat.S_ISDIR(found.st_mode) else stat.S_IROTH
    if uid == 0:
        return True
    if uid is not None and found.st_uid == uid:
        need <<= 6  # the bit of the owner
    elif found.st_gid in gids:
        need <<= 3  # the bit of the group
    return bool(found.st_mode & need)
