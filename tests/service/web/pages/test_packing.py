"""The first view in one script and one style sheet."""

import re
from pathlib import Path

import pytest

from service.web.pages import static_directory
from service.web.pages.packing import PackingError, packed_files
from tools.page_types import main

APP = "js/app.js"
STYLE = "css/first.css"


def page(folder: Path, style: str = "", **modules: str) -> Path:
    """A page of a few files; a name with ``_`` is one in the folder of the views."""
    for place in ("js/views", "css", "vendor"):
        (folder / place).mkdir(parents=True, exist_ok=True)
    (folder / STYLE).write_text(style)
    for name, text in modules.items():
        (folder / f"js/{name.replace('_', '/')}.js").write_text(text)
    return folder


def test_modules_stand_in_the_order_of_their_imports_without_the_words(tmp_path: Path) -> None:
    static = page(
        tmp_path,
        app="import { View } from './views/first.js';\nimport './print.js';\nnew View();\n",
        print="const aside = 1;\n",
        dom="export const h = () => 1;\nexport async function find() {}\nlet kept = 2;\n",
        views_first=(
            "import {\n  find, h,\n}\n  from '../dom.js';\nexport class View extends Map {}\n"
        ),
        views_other="import { h } from '../dom.js';\n",
    )
    assert packed_files(static) == {
        APP: (
            "// js/dom.js\nconst h = () => 1;\nasync function find() {}\nlet kept = 2;\n"
            "// js/views/first.js\nclass View extends Map {}\n"
            "// js/print.js\nconst aside = 1;\n"
            "// js/app.js\nnew View();\n"
            "export { h, find, View };\n"
        ),
        "js/dom.js": "export { h, find } from './app.js';\n",
        "js/views/first.js": "export { View } from '../app.js';\n",
        "js/print.js": "export {  } from './app.js';\n",
        STYLE: "",
    }


def test_a_vendored_module_stays_one_of_its_own(tmp_path: Path) -> None:
    static = page(
        tmp_path,
        app="import { v } from './views/panel.js';\nv();\n",
        views_panel=(
            "import { h as make, render } from '../../vendor/view.js';\nexport const v = make;\n"
        ),
    )
    assert packed_files(static) == {
        APP: (
            "import { h as make, render } from '../vendor/view.js';\n"
            "// js/views/panel.js\nconst v = make;\n// js/app.js\nv();\nexport { v };\n"
        ),
        "js/views/panel.js": "export { v } from '../app.js';\n",
        STYLE: "",
    }


def test_lines_of_comments_are_left_out(tmp_path: Path) -> None:
    app = (
        "// What it is.\n\n/**\n * A class; see a/b.\n */\nclass A {\n  /** One. */\n"
        "  one() { return '// no */'; } // kept\n  // left out\n}\n"
    )
    assert packed_files(page(tmp_path, app=app))[APP] == (
        "// js/app.js\n\nclass A {\n  one() { return '// no */'; } // kept\n}\nexport {  };\n"
    )


@pytest.mark.parametrize(
    ("app", "said"),
    [
        ("const h = 1;\n", "js/app.js: h is declared in js/dom.js too, rename one"),
        ("import { put } from './dom.js';\n", "js/app.js: import of 'put'"),
        ("import { h as g } from './dom.js';\n", "js/app.js: import of 'h as g'"),
        ("import * as dom from './dom.js';\n", "expected a declaration of one name or an import"),
        ("import dom from './dom.js';\n", 'js/app.js: "import dom from'),
        ("import { h } from 'elsewhere';\n", "js/app.js: \"import { h } from 'elsewhere';\""),
        ("export default class Page {}\n", "js/app.js: 'export default class Page {}'"),
        ("const a = 1;\nexport { a };\n", "js/app.js: 'export { a };'"),
        ("const { a } = b;\n", "js/app.js: 'const { a } = b;'"),
        ("import { round } from './round.js';\n", "js/round.js: import of js/app.js"),
        ("import { a as h } from '../vendor/a.js';\n", "vendor/a.js: h is declared in js/dom.js"),
        (
            "import { v } from './view.js';\nimport { b } from '../vendor/a.js';\n",
            "js/app.js: import of vendor/a.js, expected that of one module",
        ),
    ],
)
def test_what_cannot_be_packed_is_refused_by_file_and_name(
    tmp_path: Path, app: str, said: str
) -> None:
    dom = "export const h = 1;\n"
    static = page(
        tmp_path,
        app=f"import './dom.js';\n{app}",
        dom=dom,
        round="import './app.js';\nexport const round = 1;\n",
        view="import { a } from '../vendor/a.js';\nexport const v = 1;\n",
    )
    with pytest.raises(PackingError, match=re.escape(said)):
        packed_files(static)


def test_sheets_take_the_place_of_their_imports(tmp_path: Path) -> None:
    style = '/* all */\n@import "../vendor/chart.css";\n@import "base.css";\n'
    static = page(tmp_path, style=style + '@import "print.css" print;\n', app="")
    (static / "vendor/chart.css").write_text(".plot{}")
    (static / "css/base.css").write_text("a { src: url(../fonts/a.woff); }\n")
    (static / "css/print.css").write_text("@page { margin: 0; }\n")
    assert packed_files(static)[STYLE] == (
        "/* all */\n.plot{}\na { src: url(../fonts/a.woff); }\n\n"
        "@media print {\n@page { margin: 0; }\n}\n"
    )


@pytest.mark.parametrize(
    ("style", "chart", "said"),
    [
        ('@import "../vendor/chart.css";\n', "a { src: url(a.woff); }", "vendor/chart.css: url()"),
        ("@import url(../vendor/chart.css);\n", "", "css/first.css: '@import url"),
        ('@import "../vendor/chart.css" screen;\n', "", "css/first.css: '@import \"../vendor"),
    ],
)
def test_sheets_that_would_mean_something_else_are_refused(
    tmp_path: Path, style: str, chart: str, said: str
) -> None:
    static = page(tmp_path, style=style, app="")
    (static / "vendor/chart.css").write_text(chart)
    with pytest.raises(PackingError, match=re.escape(said)):
        packed_files(static)


def test_the_page_is_packed_whole() -> None:
    files = packed_files(static_directory())
    assert len(files) > 40
    (vendored,) = re.findall(r"^import\b.*", files[APP], re.MULTILINE)
    assert vendored.endswith("from '../vendor/preact.js';")
    assert "@import" not in files[STYLE]
    index = (static_directory() / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'<script type="module" src="(.*?)">', index) == [APP]
    assert re.findall(r'<link rel="stylesheet" href="(.*?)">', index) == [STYLE]


def test_every_module_imports_what_others_export() -> None:
    """In one packed module a forgotten import shows nowhere; in the module alone it would."""
    static = static_directory()
    stubs = {path: text for path, text in packed_files(static).items() if path not in (APP, STYLE)}
    exported = {
        name: path
        for path, text in stubs.items()
        for name in re.findall(r"\w+", text.partition("}")[0])[1:]
    }
    forgotten = []
    for path in (*stubs, APP):
        text = (static / path).read_text(encoding="utf-8")
        text = re.sub(r"^\s*//.*|/\*[\s\S]*?\*/", "", text, flags=re.MULTILINE)
        known = set(re.findall(r"\w+", " ".join(re.findall(r"^import \{([^}]*)", text, re.M))))
        for name, home in exported.items():
            # Calls of functions, and classes and constants; no methods, fields or words in quotes.
            used = rf"{name}\b(?!:)" if name[0].isupper() else rf"{name}\((?!.*\) \{{$)"
            if home != path and name not in known:
                forgotten += [
                    f"{path}: {name}" for _ in re.findall(rf"(?<![\w.$'#]){used}", text, re.M)
                ]
    assert forgotten == []


def test_no_line_of_a_text_looks_like_a_comment() -> None:
    """Lines of comments are left out wherever they stand, also in a text between backquotes."""
    for path in packed_files(static_directory()):
        text = (static_directory() / path).read_text(encoding="utf-8")
        for found in re.findall(r"`[^`]*`", text):
            assert not re.search(r"\n *(//|/\*)", found), f"{path}: {found}"


def test_the_check_of_the_page_finds_what_a_start_would(tmp_path: Path) -> None:
    types = tmp_path / "api.d.ts"
    with pytest.raises(SystemExit, match=r"page: js/app.js: h is declared in js/dom.js too"):
        main(types, page(tmp_path, app="import './dom.js';\nlet h = 1;\n", dom="let h = 1;\n"))
    assert not types.exists()
    main(types, static_directory())
    assert types.exists()
