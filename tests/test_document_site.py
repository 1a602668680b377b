"""What a page of the site may not do: load anything from another host."""

import importlib.util

import pytest
from document_blocks import ROOT

SPEC = importlib.util.spec_from_file_location("assets", ROOT / "docs/site/assets.py")
assets = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(assets)


def write_page(folder, *, head="", body=""):
    text = f"<html><head>{head}</head><body>{body}</body></html>"
    (folder / "page.html").write_text(text, encoding="utf-8")


@pytest.mark.parametrize(
    "head, body",
    [
        ('<script src="https://cdn.example/x.js"></script>', ""),
        ('<link rel="stylesheet" href="//fonts.example/x.css">', ""),
        ('<link rel="preconnect" href="https://fonts.example" crossorigin>', ""),
        ("<style>body { background: url(https://a.example/b.png) }</style>", ""),
        ('<style>@import "https://a.example/b.css";</style>', ""),
        ("", '<p style="background: url(//a.example/b.png)">x</p>'),
        ("", '<img src="HTTPS://a.example/b.png">'),
        ("", '<img src="b.png" srcset="b.png 1x, https://a.example/b.png 2x">'),
        ("", '<iframe src="https://a.example"></iframe>'),
        ("", '<pre class="mermaid"><code>graph LR</code></pre>'),
    ],
)
def test_what_a_page_would_load_from_another_host_is_found(tmp_path, head, body):
    write_page(tmp_path, head=head, body=body)
    (found,) = assets.list_outside(tmp_path)
    assert found.startswith("page.html loads ")
    with pytest.raises(
        SystemExit, match="must load nothing from other hosts, but page"
    ):
        assets.on_post_build({"site_dir": str(tmp_path)})


def test_styles_are_read_too(tmp_path):
    (tmp_path / "a.css").write_text(
        "@font-face { src: url('https://a.example/b.woff') }"
    )
    assert list(assets.list_outside(tmp_path)) == [
        "a.css loads https://a.example/b.woff"
    ]


def test_links_to_follow_and_own_files_are_no_fault(tmp_path):
    write_page(
        tmp_path,
        head='<link rel="canonical" href="https://a.example"><link href="own.css">',
        body='<a href="https://a.example">there</a><img src="data:image/png;base64,aa">'
        '<img src="own.png"><p>url(https://a.example)</p>',
    )
    (tmp_path / "own.css").write_text("p { background: url(own.png) }")
    assert list(assets.list_outside(tmp_path)) == []
    assets.on_post_build({"site_dir": str(tmp_path)})
