"""Pages of the site that are no Markdown file of this folder; mkdocs.yml names it.

CONTRIBUTING becomes a page, and so does the notebook with its stored outputs. Formulas
become pictures (SVG) in the page, which need neither a script nor a font.
"""

import html
import re
from pathlib import Path
from xml.etree import ElementTree

import nbconvert
import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from ziamath.config import config as ziamath_config
from ziamath.zmath import Latex

ROOT = Path(__file__).parents[2]
ziamath_config.svg2 = False  # each picture stands alone
_FONT_SIZE = 21.0  # that ziamath's 24 pixels become one of the text's
_FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<latex>.*?)\\[)\]]</(?P=tag)>',
    flags=re.DOTALL,
)
# What a browser would load at once from another host; links to follow may lead there.
_OUTSIDE = re.compile(
    r"<(?:script|img|iframe|source|link(?![^>]*rel=\"?(?:canonical|next|prev)))"
    r"[^>]*(?:src|href)=[\"']?(?:https?:)?//[^\"'\s>]+"
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    made: dict[str, str | bytes] = {
        "contributing.md": re.sub(r"(\]\()docs/", r"\1", text)
    }
    for notebook in [file for file in files if file.src_uri.endswith(".ipynb")]:
        files.remove(notebook)
        made |= convert_notebook(Path(str(notebook.abs_src_path)))
    for uri, content in made.items():
        files.append(File.generated(config, uri, content=content))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Links to the notebook and to CONTRIBUTING lead to their pages."""
    markdown = markdown.replace("](../CONTRIBUTING.md", "](contributing.md")
    return re.sub(r"(\]\(\w+)\.ipynb\b", r"\1.md", markdown)


def on_page_content(content: str, **_: object) -> str:
    """Formulas as pictures."""
    return _FORMULA.sub(_draw_formula, content)


def on_post_build(config: MkDocsConfig, **_: object) -> None:
    """End the build where a page would load something from another host."""
    for path in sorted(Path(config["site_dir"]).rglob("*.html")):
        if found := _OUTSIDE.search(path.read_text(encoding="utf-8")):
            raise SystemExit(
                f"Error: Pages must load nothing from other hosts, but {path.name} has "
                f"{found[0]}; put what it needs into docs/."
            )


def convert_notebook(path: Path) -> dict[str, str | bytes]:
    """A notebook as a page, and its figures by the names that they get."""
    text, resources = nbconvert.MarkdownExporter().from_notebook_node(
        nbformat.read(path, as_version=4),
        resources={"output_files_dir": f"{path.stem}_files", "unique_key": "figure"},
    )
    return {f"{path.stem}.md": text} | resources["outputs"]


def _draw_formula(match: re.Match[str]) -> str:
    latex = html.unescape(match["latex"]).strip()
    is_block = match["tag"] == "div"
    formula = Latex(latex, inline=not is_block, color="currentColor")
    picture = formula.svgxml()
    # Sizes in those of the text around it.
    for name in ("width", "height"):
        picture.set(name, f"{float(picture.get(name, 0)) / _FONT_SIZE:.3f}em")
    picture.set("style", f"vertical-align: {formula.getyofst() / _FONT_SIZE:.3f}em")
    picture.set("role", "img")
    picture.set("aria-label", latex)
    drawn = ElementTree.tostring(picture, encoding="unicode")
    tag, kind = match["tag"], "block" if is_block else "inline"
    return f'<{tag} class="formula-{kind}">{drawn}</{tag}>'
