"""Adds the gallery of displays to the site: displays.py LUMISTACK WORK SITE SCENES..., or displays.py --check.

Every display has a folder with its scene, its job and its viewer. Jobs run in WORK; later calls use the results
in WORK again. SCENES are folders of scenes. A display is left out if none of these folders has its scene.
With --check the program only checks displays.toml.
"""

import html
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

from build import PAGE, ROOT, navigation

#: Keys of the table `render` that every job gets in addition to the keys in displays.toml.
RENDER = {"zone_samples": 200}
STYLE = """
.displays { display: grid; grid-template-columns: repeat(auto-fill, minmax(17rem, 1fr)); gap: 1.6rem; padding: 0; list-style: none; }
.displays h2 { margin: .5rem 0 .1rem; font-size: 1.15rem; }
.displays p { margin: .2rem 0; }
.displays img { display: block; width: 100%; aspect-ratio: 8 / 5; object-fit: cover; border-radius: 6px; background: #000; }
.displays small { opacity: .8; }
"""
INTRO = """<style>{style}</style><h1>Displays</h1>
<p>{count} displays, simulated: open one, and move the mouse or a finger to look around in it. Each comes with its scene and its job:
<code>lumistack run job.toml</code> in its folder makes the same patterns. <a href="../solve/index.html">Make one from a model of your own</a>;
the model stays on your computer.</p><ul class="displays">{cards}</ul>
"""
CARD = """<li><a href="{name}/index.html"><img src="{name}/stack/poster.jpg" alt="" loading="lazy" width="400" height="250"></a>
<h2><a href="{name}/index.html">{title}</a></h2><p>{caption}</p><p>{facts}</p>
<p><a href="{name}/job/job.toml">Job</a> · <a href="{name}/job/{scene}">scene</a></p><p><small>Scene: <a href="{terms}">{licence}</a></small></p></li>
"""


def toml_of(job: dict[str, Any]) -> str:
    """Returns a job as TOML. Plain values are written as JSON, which is also valid TOML."""
    lines = [f"{key} = {json.dumps(value)}" for key, value in job.items() if not isinstance(value, (dict, list))]
    for key, value in job.items():
        for table in value if isinstance(value, list) else [value] if isinstance(value, dict) else []:
            lines.append(f"\n[[{key}]]" if isinstance(value, list) else f"\n[{key}]")
            for name, entry in table.items():
                text = ", ".join(f"{k} = {json.dumps(v)}" for k, v in entry.items()) if isinstance(entry, dict) else ""
                lines.append(f"{name} = {{ {text} }}" if text else f"{name} = {json.dumps(entry)}")
    return "\n".join(lines) + "\n"


def job_of(display: dict[str, Any]) -> dict[str, Any]:
    params = {"title": display["title"], "caption": display["caption"], "single_file": False, "target": False}
    tables = {**display["job"], "render": {**RENDER, **display["job"].get("render", {})}}
    output = {"plugin": "web_simulator", "name": "viewer", "params": params}
    return {"scene": Path(display["scene"]).name, **tables, "outputs": [output]}


def check(displays: list[dict[str, Any]]) -> None:
    """Ends the program with an error if TOML does not read a job back unchanged, or if a preset or a scene of this repository is missing."""
    for display in displays:
        job, scene = job_of(display), ROOT / "scenes" / display["scene"]
        preset = ROOT / f"scenes/displays/{job['display']['preset']}.toml"
        ours = "Lumistack" in display["licence"]
        if tomllib.loads(toml_of(job)) != job or not preset.is_file() or (ours and not scene.is_file()):
            sys.exit(f"displays.toml: {display['name']}: expected a preset, a scene and a job, found {display}")
    if len({display["name"] for display in displays}) != len(displays):
        sys.exit("displays.toml: expected names that differ, found a name twice")


def make(display: dict[str, Any], scene: Path, folder: Path, program: str) -> dict[str, Any]:
    """Runs a display's job in `folder`; returns its report."""
    job = folder / "job"
    job.mkdir(parents=True, exist_ok=True)
    for path in [scene, *(path for pattern in display["files"] for path in sorted(scene.parent.glob(pattern)))]:
        shutil.copy2(path, job / path.name)
    (job / "job.toml").write_text(toml_of(job_of(display)))
    print(f"gallery: {display['name']}", flush=True)
    run = [program, "run", str(job / "job.toml"), "-o", str(folder / "run")]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"gallery: {display['name']}: {done.stderr[-2000:]}")
    return json.loads((folder / "run/report.json").read_text())


def facts_of(report: dict[str, Any], preview: dict[str, Any]) -> str:
    layers, frames = len(preview["display"]["layers"]), preview["frames"]
    lit = ", directional backlight" if "lenslets" in json.dumps(preview["display"].get("backlight", "")) else ""
    many = f"{layers} layer{'s' * (layers > 1)}, {frames} frame{'s' * (frames > 1)}{lit}"
    return f"{many}; {report['psnr_zone']:.1f} dB over its zone"


def main(displays: list[dict[str, Any]], program: str, work: Path, site: Path, folders: list[Path]) -> None:
    cards = []
    for display in displays:
        name = display["name"]
        folder = next((folder for folder in folders if (folder / display["scene"]).is_file()), None)
        if folder is None:
            print(f"gallery: {name} is left out: {display['scene']} is in none of {', '.join(map(str, folders))}")
            continue
        scene, terms = folder / display["scene"], display["terms"]
        report = make(display, scene, work / name, program)
        if not terms.startswith("https:"):
            terms = f"{name}/job/LICENCE.txt"
            shutil.copyfile(folder / display["terms"], work / name / "job/LICENCE.txt")
        [stack] = (work / name / "run/outputs").rglob("viewer/stack")
        shutil.copytree(stack.parent, site / "displays" / name)
        shutil.copytree(work / name / "job", site / "displays" / name / "job")
        preview = json.loads((stack / "preview.json").read_text())
        texts = {key: html.escape(display[key]) for key in ["title", "caption", "licence"]}
        cards.append(CARD.format(name=name, scene=scene.name, terms=terms, facts=facts_of(report, preview), **texts))
    body = INTRO.format(style=STYLE, count=len(cards), cards="".join(cards))
    page = PAGE.format(title="Displays", root="../", nav=navigation("displays/index", True), body=body)
    (site / "displays/index.html").write_text(page)
    # copy the page that solves (`solve.html`), with its built-in scenes
    shutil.copytree(ROOT / "web/dist", site / "solve", ignore=shutil.ignore_patterns("types", "live.js", "sources.blake3", "index.html"))
    shutil.copyfile(ROOT / "web/dist/solve.html", site / "solve/index.html")
    for link in re.findall(r'(?:href|src)="([^"]+)"', page):
        if not re.match("[a-z]+:", link) and not (site / "displays" / link).resolve().exists():
            sys.exit(f"gallery: expected a link to an existing file, found {link}")
    size = sum(path.stat().st_size for path in site.rglob("*") if path.is_file())
    print(f"gallery: {len(cards)} displays; the site has {size / 1e6:.0f} MB")


ALL = tomllib.loads(Path(__file__).with_name("displays.toml").read_text())["display"]
check(ALL)
if sys.argv[1] != "--check":
    main(ALL, sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), [Path(folder) for folder in sys.argv[4:]])
