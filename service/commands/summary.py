"""Lines for a terminal about a scene document: selection, self-check, fading, and what was left out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

_NAMES_VIEWS = re.compile(r"\b(view|photographs) \d")


def check_line(check: Mapping[str, Any]) -> str:
    """The self-check in a line: PSNR of the inputs, and the shares of pixels without texture or parallax."""
    parts = [f"inputs drawn again: {_decibels(check['input_views'])}"]
    for name, share in (("textureless", "textureless_share"), ("without parallax", "no_parallax_share")):
        if check[share] is not None:
            parts.append(f"{100 * check[share]:.1f} % {name}")
    for name, words in (("from_others", "drawn from the other views"), ("leave_one_out", "predicted by others")):
        if check.get(name):
            parts.append(f"{words}: {_decibels(check[name])}")
    if check.get("ambiguous_routes"):
        parts.append(f"{100 * check['ambiguous_routes']:.2f} % ambiguous routes")
    if check["depth_step"]["middle"] is not None:
        parts.append(f"depth candidates every {200 * check['depth_step']['middle']:.1f} % half way")
    return "; ".join(parts)


def _decibels(rows: Sequence[Mapping[str, Any]]) -> str:
    """PSNR of each view; without one there is no pixel to compare, or no other view with parallax to draw it from."""
    missing = ("no pixel" if row.get("from", True) else "no parallax" for row in rows)
    shown = [why if row["psnr"] is None else f"{row['psnr']:.1f}" for row, why in zip(rows, missing, strict=True)]
    return f"{', '.join(shown)} dB"


def fading_line(document: Mapping[str, Any]) -> str:
    """How much fading has changed opacities and colours."""
    fading = document["fading"]
    if not fading["passes"]:
        return "fading: off"
    passes = "1 pass" if fading["passes"] == 1 else f"{fading['passes']} passes"
    return (
        f"fading in {passes}: {fading['halved']:,} Gaussians lost half of their opacity or more, "
        f"{fading['gone']:,} are no longer drawn, "
        f"and colours moved by {255 * fading['recoloured']:.1f} of 255 on average"
    )


def selection_line(said: Mapping[str, Any]) -> str:
    """Which views were used, of how many, and how they were chosen."""
    why = {"all": "all there are", "select": "as asked for", "photographs": "those with a photograph"}
    reason = why.get(said["by"])
    if reason is None:
        reason = f"chosen for overlap ({said['overlap']:.0%}) and parallax ({said['parallax_degrees']:.1f} degrees)"
    views = ", ".join(map(str, said["views"]))
    missing = said.get("without_photograph")
    without = f"; {missing} have no photograph" if missing else ""
    return f"views {views} of {said['of']} in {said['cameras']} ({said['format']}): {reason}{without}"


def warning_line(warning: Mapping[str, Any]) -> str:
    """A warning with its view, unless its message names views by itself."""
    index, message = warning.get("index"), warning["message"]
    of_view = "" if index is None or _NAMES_VIEWS.search(message) else f"view {index}: "
    return f"warning: {of_view}{message}"


def left_out_lines(document: Mapping[str, Any]) -> list[str]:
    """A table of what was left out, with its error and savings; a single line if nothing was."""
    rows, pruned = document["left_out"], document["pruning"]
    if not rows:
        return ["left out: nothing"]
    width = max(len(row["what"]) for row in rows)
    lines = [f"{'left out':{width}}       count          of  change of colour"]
    for row in rows:
        change = f"at most {row['error']:.5f}" if row["error"] else "not compared" if row["error"] is None else "none"
        lines.append(f"{row['what']:{width}}  {row['count']:10,}  {row['of']:10,}  {change}")
    if pruned.get("picture_seconds") and pruned["certified"]:
        views, (before, after) = pruned["certified"], pruned["picture_seconds"]
        lines.append(
            f"proved for {views['inputs']} inputs, {views['between']} views between them and {views['asked']} asked "
            f"for, {pruned['actual']:.5f} found in the inputs; elsewhere an estimate"
        )
        lines.append(
            f"saved {pruned['bytes_saved'] / 1e3:,.0f} kB of .ply; a picture takes {1e3 * after:.1f} ms, all of it "
            f"would take {1e3 * before:.1f} ms; deciding took {pruned['seconds']:.2f} s"
        )
    return lines
