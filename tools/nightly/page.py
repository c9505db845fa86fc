#!/usr/bin/env python3
"""Makes doc/hard_cases.md of what the tests recorded.

page.py FOLDER         the page; FOLDER holds one file of JSON lines a build
page.py --tests FILE   the tests that recorded something there, as a regular expression for ctest
"""
import json
import pathlib
import re
import sys

BUILDS = ("release", "scalar", "debug", "asan", "tsan")
root = pathlib.Path(__file__).resolve().parents[2]


def records(file):
    return [json.loads(line) for line in file.read_text().splitlines()]


if sys.argv[1] == "--tests":
    # Behind a parameterised test ctest writes the value, gtest its number.
    names = sorted({re.sub(r"/\d+$", "", r["test"]) for r in records(pathlib.Path(sys.argv[2]))})
    print("/(" + "|".join(name.replace(".", "[.]") for name in names) + ")(/.*)?$")
    sys.exit()

rows = json.loads((root / "tools/nightly/rows.json").read_text())
folder = pathlib.Path(sys.argv[1])
builds = [b for b in BUILDS if (folder / b).exists()]
if not builds:
    sys.exit("page.py: no build has recorded anything")

found = {}  # (row, what) -> {"bound", "at_least", "tests", "by": {build: worst}, "full": measured at full size}
for build in builds:
    for r in records(folder / build):
        entry = found.setdefault((r["row"], r["what"]),
                                 {"bound": r["bound"], "at_least": r["at_least"], "tests": set(), "by": {}, "full": {}})
        test = r["test"].split("/")
        entry["tests"].add("/".join(test[1:2] if len(test) > 1 and "." in test[1] else test[:1]))
        entry["full"][build] = entry["full"].get(build, True) and r["full_size"]
        worst = min if r["at_least"] else max
        values = [v for v in (entry["by"].get(build), r["measured"]) if v is not None]
        entry["by"][build] = float("nan") if r["measured"] is None else worst(values)


def number(x):
    return f"{x:.3g}" if x != int(x) or abs(x) >= 1e6 else f"{int(x)}"


def margin(entry, worst):
    bound = entry["bound"]
    kept = worst >= bound if entry["at_least"] else worst <= bound
    if worst != worst or not kept:
        return "**broken**"
    if bound == 0:
        return "exact"
    if worst == 0:
        return "all of it"
    if worst < 0:
        return f"{number(bound - worst)} more"
    ratio = worst / bound if entry["at_least"] else bound / worst
    return f"{ratio:.3g} x"


sizes = {full for e in found.values() for full in e["full"].values()}
size = {(True,): "full size", (False,): "the size that runs with each change"}.get(
    tuple(sorted(sizes)), "the size that runs with each change, at full size in builds marked *")
print("# Hard cases\n")
print(f"Made by `tools/nightly/page.py` from what the tests measured: {size}; builds: "
      + ", ".join(f"`{b}`" for b in builds) + ". The worst of all builds and of all tests of a line stands in the table; "
      "margin is how many times further from the bound it could be.\n")
print("`release` is optimised with wide code (AVX2), `scalar` the same without it, `debug` is -O0, `asan` (addresses and undefined "
      "behaviour) and `tsan` (threads) carry the sanitizers. "
      "Geometry, frames and deformations are computed in double throughout; rays, light weights and pixels in float, whose plain double "
      "counterparts (`reflectanceDotReference`, brute force in the tests) they are held against.\n")
missing = []
for row in rows:
    entries = {k: v for k, v in found.items() if k[0] == row["row"]}
    print(f"## {row['row']}. {row['case']}\n")
    print(f"Right: {row['right']}.\n")
    if row.get("seen"):
        print(f"Seen to fail: {row['seen']}.\n")
    if row.get("open"):
        print(f"Not so yet: {row['open']}.\n")
    if not entries:
        missing.append(str(row["row"]))
        print("No test recorded it in this run.\n")
        continue
    print("| measured | worst | bound | margin | builds | test |\n|---|---|---|---|---|---|")
    for (_, what), e in entries.items():
        values = list(e["by"].values())
        worst = float("nan") if any(v != v for v in values) else (min if e["at_least"] else max)(values)
        sign = "at least" if e["at_least"] else "at most"
        what = what.replace("|", "\\|")
        by = ", ".join(build + (" *" if len(sizes) > 1 and e["full"][build] else "") for build in e["by"])
        print(f"| {what} | {number(worst)} | {sign} {number(e['bound'])} | {margin(e, worst)} | {by} | `{'`, `'.join(sorted(e['tests']))}` |")
    print()
    for picture in sorted((root / "doc/images/hard_cases").glob(f"{row['row']:02d}_*.png")):
        print(f"![{row['case']}](images/hard_cases/{picture.name})\n")
if missing:
    print(f"Rows without a record in this run: {', '.join(missing)}.")
