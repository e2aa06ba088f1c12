"""A service's certificate is judged before its clients judge it."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
import zenoh

from edge.bus.certificate import SOON_S, judge, runs_out
from edge.bus.zenoh_file import TLS

DAY_S = 86400.0
MAKE = """
set -eu
new="-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes"
for ca in ca other; do
  openssl req -x509 $new -subj /CN=$ca -days 99 -keyout $ca.key -out $ca.crt
done
openssl req $new -subj /CN=service -keyout good.key -out good.csr
openssl x509 -req -in good.csr -CA ca.crt -CAkey ca.key -CAcreateserial -days 60 -out good.crt
openssl x509 -req -in good.csr -CA ca.crt -CAkey ca.key -CAcreateserial -days -1 -out old.crt
cp good.key old.key
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificates, and is not there")
    folder = tmp_path_factory.mktemp("certificates")
    subprocess.run(["bash", "-c", MAKE], cwd=folder, check=True, capture_output=True)
    return folder


def named(made: Path, certificate: str, key: str, roots: str) -> zenoh.Config:
    found = zenoh.Config()
    names = {"listen_certificate": f"{certificate}.crt", "listen_private_key": f"{key}.key",
             "root_ca_certificate": f"{roots}.crt"}  # fmt: skip
    for name, file in names.items():
        found.insert_json5(f"{TLS}/{name}", json.dumps(str(made / file)))
    return found


def test_where_none_is_named_nothing_is_said():
    assert judge(zenoh.Config()) is None


@pytest.mark.parametrize(
    ("certificate", "key", "roots", "says"),
    [
        ("old", "old", "ca", "out of date, or the clock is wrong (certificate has expired)"),
        ("good", "good", "other", "does not take it (unable to get local issuer certificate)"),
        ("good", "ca", "ca", "cannot be used with its key and authority"),
        ("good", "gone", "ca", "cannot be used with its key and authority"),
    ],
)
def test_what_no_client_would_take_is_said_in_one_line(made, certificate, key, roots, says):
    line = judge(named(made, certificate, key, roots))
    assert line.startswith(f"{made}/{certificate}.crt: ")
    assert says in line
    assert "\n" not in line


def test_one_that_soon_runs_out_is_told(made):
    found = named(made, "good", "good", "ca")
    end_s = runs_out(*(str(made / name) for name in ("good.crt", "good.key", "ca.crt")))
    assert judge(found) is None
    assert judge(found, end_s - SOON_S - DAY_S) is None
    assert "runs out in 3 days" in judge(found, end_s - 3 * DAY_S)
