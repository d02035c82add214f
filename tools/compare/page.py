"""The page: pictures side by side, differences, figures, a verdict a line."""

import base64
import html
import io
import pathlib

import mitsuba as mi
import numpy as np


def tone(image):
    """Linear to display values."""
    x = np.clip(image, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 1e-9), 1 / 2.4) - 0.055)


def picture(image, size, display=True):
    """An <img> of [pixel, channel] linear values; three channels are shown (of four bands the last three, reversed)."""
    if image.shape[1] == 4:
        image = image[:, [3, 2, 0]]
    shown = (tone(image) if display else image).reshape(size, size, 3)
    shown = np.repeat(np.repeat(shown, 192 // size or 1, axis=0), 192 // size or 1, axis=1)
    stream = mi.MemoryStream()
    pixels = np.ascontiguousarray(np.clip(shown * 255 + 0.5, 0, 255).astype(np.uint8))
    mi.Bitmap(pixels).write(stream, mi.Bitmap.FileFormat.PNG)
    return f'<img src="data:image/png;base64,{base64.b64encode(stream.raw_buffer()).decode()}">'


def difference(a, b, size):
    """Relative difference as colour: grey is none, white +5 % of the mean, black −5 %."""
    scale = max(float(b.mean()), 1e-9)
    return picture(np.clip(0.5 + (a - b) / scale * 10, 0, 1), size, display=False)


STYLE = """body{font:15px/1.5 sans-serif;margin:2em auto;max-width:1150px;color:#222}
table{border-collapse:collapse;margin:.6em 0}td,th{padding:.2em .8em;text-align:right;border-bottom:1px solid #ddd}
td:first-child,th:first-child{text-align:left}figure{display:inline-block;margin:.3em;text-align:center}
img{image-rendering:pixelated;width:192px}.pass{color:#060}.fail{color:#b00;font-weight:bold}.refused{color:#850}"""


def write(path, report, pictures, size):
    """Writes the page, whole or not at all."""
    out = io.StringIO()
    out.write(f"<!doctype html><meta charset=utf-8><title>Ways to a pearl</title><style>{STYLE}</style>")
    out.write(
        "<h1>Ways to a pearl</h1><p>Differences are drawn as grey ± 5 % of the mean. (d) answers for some of "
        "the samples of each pixel: shown is its difference to (b) on these, on top of (b).</p>"
    )
    for key, shown in pictures.items():
        out.write(f"<h2>{html.escape(key)}</h2>")
        reference = shown.get("b")
        for name, image in shown.items():
            out.write(f"<figure>{picture(image, size)}<figcaption>{html.escape(name)}</figcaption></figure>")
            if reference is not None and name != "b":
                out.write(f"<figure>{difference(image, reference, size)}<figcaption>{name} − b</figcaption></figure>")
        out.write("<table><tr><th>comparison<th>figure<th>value<th>limit<th>verdict</tr>")
        for line in report["lines"]:
            if line["scene"] == key:
                value = "" if line["value"] is None else f"{line['value']:.3g}"
                limit = "" if line["limit"] is None else line["limit"]
                note = html.escape(line.get("why", ""))
                out.write(f"<tr><td>{line['ways']}<td>{line['figure']}<td>{value}<td>{limit}"
                          f"<td class={line['verdict']}>{line['verdict']} {note}</tr>")  # fmt: skip
        out.write("</table>")
    whole = pathlib.Path(f"{path}.tmp")
    whole.write_text(out.getvalue())
    whole.replace(path)
