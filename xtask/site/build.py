"""Builds the documentation as a web site in FOLDER. A link to a missing page or heading is an error, and so is a page
without a picture. With --displays, every page links to the gallery, which displays.py adds.

usage: build.py FOLDER [--displays]
"""

import html
import posixpath
import re
import shutil
import sys
from pathlib import Path

import markdown

ROOT = Path(__file__).resolve().parents[2]
#: Navigation of every page: headings, and pages with their titles.
PARTS = {
    "Start here": {
        "README.md": "Lumistack",
        "docs/FIRST_HOUR.md": "The first hour",
        "docs/start/ARTISTS.md": "Artists",
        "docs/start/DISPLAY_BUILDERS.md": "Display builders",
        "docs/start/RUST.md": "Rust developers",
        "docs/start/PYTHON.md": "Python users",
    },
    "Scenes": {
        "docs/GLTF.md": "glTF",
        "docs/USD.md": "USD",
        "docs/SPLATS.md": "Captures",
        "docs/BLENDER.md": "Blender",
        "scenes/README.md": "Sample scenes",
    },
    "Displays": {
        "docs/JOB.md": "Job and display files",
        "docs/DESIGN_TOOLS.md": "Design tools",
        "docs/ZONE.md": "The zone",
        "docs/PANELS.md": "Panels",
    },
    "Work": {
        "docs/PYTHON.md": "Python",
        "docs/FARM.md": "Many machines",
        "web/README.md": "Viewer for web pages",
        "docs/PLUGINS.md": "Plugins",
    },
    "Project": {
        "ARCHITECTURE.md": "Architecture",
        "CONTRIBUTING.md": "Contributing",
        "CHANGELOG.md": "Changelog",
    },
}
STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #fff; --line: #d8dee4; --soft: #f3f5f7; --link: #0a58ca; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ec; --paper: #14171a; --line: #333a41; --soft: #1d2226; --link: #7db2ff; } }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: var(--paper); font: 16px/1.6 system-ui, sans-serif; display: flex; }
nav { flex: 0 0 15rem; padding: 1.5rem; border-right: 1px solid var(--line); height: 100vh; position: sticky; top: 0; overflow: auto; }
nav h2 { font-size: .8rem; margin: 1.2rem 0 .3rem; opacity: .75; }
nav a { display: block; padding: .1rem 0; text-decoration: none; }
nav a[aria-current] { font-weight: 600; }
main { flex: 1 1 0; min-width: 0; max-width: 62rem; padding: 1rem 2.5rem 4rem; }
a { color: var(--link); }
img { max-width: 100%; height: auto; border-radius: 6px; }
img[src*="design/"] { background: #fff; }
pre { background: var(--soft); padding: .8rem 1rem; overflow: auto; border-radius: 6px; line-height: 1.4; }
code { font: .9em/1.4 ui-monospace, monospace; }
:not(pre) > code { background: var(--soft); padding: .1em .3em; border-radius: 4px; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
th, td { border: 1px solid var(--line); padding: .35rem .6rem; text-align: left; vertical-align: top; }
@media (max-width: 50rem) {
  body { flex-direction: column; }
  nav { order: 1; flex: none; height: auto; position: static; border: 0; border-top: 1px solid var(--line); }
  main { flex: none; width: 100%; padding: 0 1.2rem 3rem; }
}
"""
PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title} · Lumistack</title><link rel="icon" href="data:,"><link rel="stylesheet" href="{root}style.css"></head>
<body><nav aria-label="Pages">{nav}</nav><main>{body}</main></body></html>
"""


def slug(text: str, separator: str) -> str:
    """Makes the anchor of a heading as GitHub and other forges do."""
    return re.sub(r"[^\w\- ]", "", text.lower()).strip().replace(" ", separator)


def page_of(path: str) -> str:
    return path.removesuffix(".md") + ".html"


def title_of(source: Path) -> str:
    first = next((line for line in source.read_text().splitlines() if line.startswith("# ")), source.stem)
    return first.removeprefix("# ").strip()


def navigation(path: str, displays: bool) -> str:
    """Returns the links for the navigation of the page `path`. With `displays`, it also has a link to the gallery."""
    root = "../" * path.count("/")
    parts = {part: {page_of(page): title for page, title in pages.items()} for part, pages in PARTS.items()}
    if displays:
        parts = {"See": {"displays/index.html": "Displays", "solve/index.html": "Make your own"}, **parts}
    lines = []
    for part, pages in parts.items():
        lines.append(f"<h2>{part}</h2>")
        for other, title in pages.items():
            here = ' aria-current="page"' if other == page_of(path) else ""
            lines.append(f'<a href="{root}{other}"{here}>{html.escape(title)}</a>')
    return "".join(lines)


class Site:
    def __init__(self, folder: Path, displays: bool) -> None:
        self.folder = folder
        self.displays = displays
        self.pages = {path: title for part in PARTS.values() for path, title in part.items()}
        for source in sorted((ROOT / "docs").rglob("*.md")):
            path = source.relative_to(ROOT).as_posix()
            self.pages.setdefault(path, title_of(source))
        self.problems: list[str] = []
        self.anchors: dict[str, set[str]] = {}
        self.wanted: list[tuple[str, str, str]] = []

    def link(self, path: str, target: str) -> str | None:
        """Returns the target of a link on the site; None for a folder, which has no page."""
        if re.match(r"[a-z]+:", target):
            return target
        target, _, anchor = target.partition("#")
        full = posixpath.normpath(posixpath.join(posixpath.dirname(path), target)) if target else path
        place = ROOT / full
        if full in self.pages:
            if anchor:
                self.wanted.append((path, full, anchor))
            return (page_of(target) if target else "") + (f"#{anchor}" if anchor else "")
        if place.is_dir():
            return None
        if not place.is_file() or not place.is_relative_to(ROOT):
            self.problems.append(f"{path}: expected a link to an existing file, found {target}")
            return target
        copy = self.folder / full
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(place, copy)
        return target

    def write(self, path: str) -> None:
        maker = markdown.Markdown(
            extensions=["tables", "fenced_code", "toc", "sane_lists"],
            extension_configs={"toc": {"slugify": slug}},
        )
        text = (ROOT / path).read_text()
        # GitHub accepts a list directly after a line of text. This Markdown library needs an empty
        # line before a list, so add one.
        text = re.sub(r"(?m)^(?!\s*(?:[*-]|\d+\.) |\s*$|\s+)(.+)\n(?=[*-] |\d+\. )", r"\1\n\n", text)
        body = maker.convert(text)
        self.anchors[path] = set(re.findall(r'id="([^"]+)"', body))

        def linked(match: re.Match[str]) -> str:
            found = self.link(path, html.unescape(match[2]))
            return f'{match[1]}="{html.escape(found)}"' if found is not None else f'data-folder="{match[2]}"'

        body = re.sub(r'\b(href|src)="([^"]*)"', linked, body)
        if not re.search(r'<img [^>]*alt="[^"]', body):
            self.problems.append(f"{path}: expected a picture with an alternative text, found none; CONTRIBUTING.md, *Publish the site*")
        place = self.folder / page_of(path)
        place.parent.mkdir(parents=True, exist_ok=True)
        root = "../" * path.count("/")
        title = html.escape(self.pages[path])
        place.write_text(PAGE.format(title=title, root=root, nav=navigation(path, self.displays), body=body))

    def build(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        (self.folder / "style.css").write_text(STYLE)
        for path in self.pages:
            self.write(path)
        shutil.copyfile(self.folder / "README.html", self.folder / "index.html")
        for path, full, anchor in self.wanted:
            if anchor not in self.anchors[full]:
                self.problems.append(f"{path}: expected a heading of {full}, found #{anchor}")


if __name__ == "__main__":
    site = Site(Path(sys.argv[1]), "--displays" in sys.argv)
    site.build()
    print(f"site: {len(site.pages)} pages in {site.folder}")
    if site.problems:
        sys.exit("\n".join(site.problems))
