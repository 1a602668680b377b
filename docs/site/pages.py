"""Pages of the site that are no Markdown file of this folder; mkdocs.yml names it.

README, CONTRIBUTING and CHANGELOG become pages, the notebook is run and becomes one
with its figures, and formulas become pictures (SVG) in the page, which need neither a
script nor a font.
"""

import html
import re
from pathlib import Path
from xml.etree import ElementTree

import nbclient
import nbconvert
import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from traitlets.config import Config
from ziamath.config import config as ziamath_config
from ziamath.zmath import Latex

ROOT = Path(__file__).parents[2]
# A file of the repository: its page.
PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
MAX_SECONDS = 300  # of a cell
ziamath_config.svg2 = False  # each picture stands alone
_FONT_SIZE = 21.0  # that ziamath's 24 pixels become one of the text's
_FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<latex>.*?)\\[)\]]</(?P=tag)>',
    flags=re.DOTALL,
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    made: dict[str, str | bytes] = {}
    for name, page in PAGES.items():
        made[page] = move_links((ROOT / name).read_text(encoding="utf-8"))
    for notebook in [file for file in files if file.src_uri.endswith(".ipynb")]:
        files.remove(notebook)
        made |= run_notebook(Path(str(notebook.abs_src_path)))
    for uri, content in made.items():
        files.append(File.generated(config, uri, content=content))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Links to notebooks lead to their pages."""
    return re.sub(r"(\]\(\w+)\.ipynb\b", r"\1.md", markdown)


def on_page_content(content: str, **_: object) -> str:
    """Formulas as pictures."""
    return _FORMULA.sub(_draw_formula, content)


def move_links(text: str) -> str:
    """The Markdown of a file at the repository's root, as of a page in docs/."""
    text = re.sub(r"(\]\()docs/", r"\1", text)
    for name, page in PAGES.items():
        text = text.replace(f"]({name}", f"]({page}")
    return text


def run_notebook(path: Path) -> dict[str, str | bytes]:
    """Run a notebook; its page and its figures by the names that they get.

    Raises:
      nbclient.exceptions.CellExecutionError: a cell failed.
    """
    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(
        notebook,
        timeout=MAX_SECONDS,
        kernel_name="python3",
        resources={"metadata": {"path": str(ROOT)}},
        config=Config(KernelManager={"transport": "ipc"}),  # no port is opened
    ).execute()
    text, resources = nbconvert.MarkdownExporter().from_notebook_node(
        notebook,
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
