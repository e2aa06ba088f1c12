"""HTML documents for reports and evaluations, each in one file.

A document fetches nothing, and no script can run in it but the given one.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable
from html import escape

import cv2
import numpy as np

import edge
from edge.lab.report.style import CSS

JPEG_QUALITY = 85


def document(title: str, body: str, machine: str, style: str = "", script: str = "") -> str:
    """Return a document in the reports' style, with a footer that names version and machine.

    Title and machine are plain text; the body is markup with all text escaped. The style is added
    to the reports' own. The document's security policy has the hash of the script, so no other
    script can run.
    """
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    if script:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
        policy += f"; script-src 'sha256-{digest}'"
    footer = f"<footer>edge {edge.__version__} · {escape(machine)}</footer>"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{CSS}{style}</style></head>"
        f"<body><main>{body}{footer}</main>"
        f"{f'<script>{script}</script>' if script else ''}</body></html>\n"
    )


def image_figure(rgb: np.ndarray, caption: str, marks: str = "") -> str:
    """Return an image (h, w, 3) uint8 as JPEG, with a plain text below.

    `marks` are SVG on top of the image, in its pixels.
    """
    h, w = rgb.shape[:2]
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    jpeg = cv2.imencode(".jpg", bgr, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes()
    return (
        f'<figure><svg viewBox="0 0 {w} {h}" role="img">'
        f'<image width="{w}" height="{h}" href="{data_url("jpeg", jpeg)}"/>{marks}</svg>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def pairs_section(title: str, pairs: Iterable[tuple[str, str]]) -> str:
    """Return a section with a table of names and values, which are plain text."""
    rows = "".join(f"<tr><td>{escape(k)}</td><td>{escape(v)}</td></tr>" for k, v in pairs)
    return f'<section><h2>{escape(title)}</h2><table class="pairs">{rows}</table></section>'


def data_url(kind: str, content: bytes) -> str:
    """Return an image as a data URL."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"
