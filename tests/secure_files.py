"""Files of `/etc/edge`, made in another folder by the commands of docs/security.md."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from live_patience import eventually

from edge.bus import client
from edge.config import ZenohConfig

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/security.md").read_text(encoding="utf-8")
USERS = {
    who: f"pw-of-{who}"
    for who in ("robot", "controller", "adapter", "operator", "recorder", "agent")
}

# A certificate that is out of date on the day that it is made, of the authority in this folder.
OUT_OF_DATE = """
openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=$1 \
  -addext extendedKeyUsage=$2 -addext subjectAltName=IP:127.0.0.1 -keyout old.key -out old.csr
openssl x509 -req -in old.csr -CA ca.crt -CAkey ca.key -CAcreateserial -copy_extensions copy \
  -days -1 -out old.crt
"""


def page_commands(folder: Path, *containing: str, page: str = PAGE) -> None:
    """Run its blocks, with `folder` for `/etc/edge`; the working directory is the project's."""
    blocks = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
    for text in containing:
        (block,) = (block for block in blocks if text in block)
        _bash(block.replace("/etc/edge", str(folder)), ROOT)


def page_section(containing: str, folder: Path, page: str = PAGE) -> str:
    """Its section of a configuration with this text, with `folder` for `/etc/edge`."""
    blocks = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    (section,) = (block for block in blocks if containing in block)
    return section.replace("/etc/edge", str(folder))


def etc_edge(folder: Path) -> Path:
    """Make `/etc/edge` by the page's commands; return it and the page's user settings."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificates, and is not there")
    page_commands(folder, "cp config/secure", "openssl req", "sed s/operator", "sed -e")
    shutil.copy(folder / "client.json5", folder / "operator.json5")
    (folder / "users.txt").write_text("".join(f"{u}:{p}\n" for u, p in USERS.items()))
    text = (folder / "password-client.json5").read_text()
    for user, password in USERS.items():
        own = text.replace('"operator"', f'"{user}"').replace("of the operator", password)
        (folder / f"password-{user}.json5").write_text(own)
    for file in folder.glob("*.json5"):
        file.write_text(file.read_text().replace("/etc/edge", str(folder)))
    return folder


def settings_of(
    etc: Path, kind: str, port: int, prefix: str = "edge"
) -> Callable[[str], ZenohConfig]:
    """Return the section `zenoh` of the service, and of each client."""
    protocol, start = ("tls", "") if kind == "certificates" else ("tcp", "password-")

    def of(who: str) -> ZenohConfig:
        return ZenohConfig(
            endpoint=f"{protocol}/127.0.0.1:{port}",
            file=str(etc / f"{start}service.json5"),
            client_file=str(etc / f"{start}{who}.json5"),
            prefix=prefix,
            shared_memory=False,
        )

    return of


def out_of_date(etc: Path, file: str, whose: str, use: str) -> Path:
    """Copy a file of `etc`, with an expired certificate."""
    _bash(f"set -- edge-{whose} {use}\n{OUT_OF_DATE}", etc / "tls")
    for kind in ("crt", "key"):
        (etc / f"tls/old.{kind}").rename(etc / f"tls/old-{whose}.{kind}")
    copy = etc / f"old-{file}"
    copy.write_text((etc / file).read_text().replace(f"tls/{whose}.", f"tls/old-{whose}."))
    return copy


def refusal(settings: ZenohConfig, told: str) -> str:
    """Return a refused command's output, once it contains `told`.

    A busy service may not give the reason in time.
    """

    def refused() -> str:
        with pytest.raises(client.RequestError) as caught:
            client.connect(settings, 0.1, "mission")  # one attempt is always made
        assert "\n" not in str(caught.value)
        return str(caught.value) if told in str(caught.value) else ""

    return eventually(refused, f"it never said {told!r}")


def _bash(script: str, folder: Path) -> None:
    done = subprocess.run(
        ["bash", "-c", f"set -eu\n{script}"], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
