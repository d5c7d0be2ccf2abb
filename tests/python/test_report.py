"""The report in a browser, on a desktop and on a phone: complete, legible, and alone with itself."""

import json
import re
import shutil
import zipfile

import numpy as np
import pytest
from conftest import ANY, DESKTOP, OTHER_THREADS, PHONE, ROOT, metafmu, show

# (width, height) in CSS pixels
SMALL_PHONE = (320, 568)
FIGURES = {
    "single-pendulum": ["density-theta", "histogram-thetadd", "median-theta", "worst-thetad", "phase-worst-theta",
                        "path-median-mass", "error-time-theta", "error-L-relative", "worst-L-c", "sensitivity-theta",
                        "training-loss", "training-rate", "coverage-theta", "models-predict", "beside-left-theta", "beside-right-worst-thetadd"],
    "double-pendulum": ["density-theta2d", "phase-median-theta1", "path-worst-lower_mass", "worst-L1-theta2d0"],
    "slider-crank": ["density-xB", "phase-worst-xB", "phase-median-phi", "path-worst-crank_pin", "error-L_over_r-relative-2"],
}

# Every figure: its axes' names, and texts that are outside of the picture or on each other
LOOK_AT_FIGURES = """
return [...document.querySelectorAll('figure')].map(figure => {
    const svg = figure.querySelector('svg'), box = svg.getBoundingClientRect();
    const texts = [...svg.querySelectorAll('text')];
    const boxes = texts.map(text => ({text: text.textContent.trim(), box: text.getBoundingClientRect()}));
    const apart = (a, b) => a.right <= b.left + 0.5 || b.right <= a.left + 0.5 || a.bottom <= b.top + 0.5 || b.bottom <= a.top + 0.5;
    const overlapping = [];
    boxes.forEach((a, i) => boxes.slice(i + 1).forEach(b => { if (!apart(a.box, b.box)) overlapping.push([a.text, b.text]); }));
    const inside = ({box: b}) => b.left >= box.left - 0.5 && b.right <= box.right + 0.5 && b.top >= box.top - 0.5 && b.bottom <= box.bottom + 0.5;
    return {
        id: figure.id, width: box.width, caption: figure.querySelector('figcaption').textContent, label: svg.getAttribute('aria-label'),
        outside: boxes.filter(text => !inside(text)).map(text => text.text), overlapping,
        texts: boxes.map(text => text.text), marks: svg.querySelectorAll('polyline, rect, circle, polygon').length,
        smallest: Math.min(...texts.map(text => parseFloat(text.getAttribute('font-size')) * box.width / svg.viewBox.baseVal.width)),
    };
});
"""

# of each part of the first screen: its lowest edge, its text, and whether something covers the middle of it
FIRST_SCREEN = """
return Object.fromEntries(arguments[0].map(selector => [selector, [...document.querySelectorAll(selector)].map(part => {
    const box = part.getBoundingClientRect(), top = document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2);
    return {bottom: box.bottom, width: box.width, height: box.height, text: part.textContent.trim(), seen: part.contains(top)};
})]));
"""
PARTS = [".verdict", "h1", ".is", ".cost", ".ranges", ".accuracy", ".strip", ".strip .value", ".strip .error"]

# elements cut at the right edge of the window
CUT = "return [...document.querySelectorAll('td, th, p, h1, h2, h3, li, figcaption')].filter(e => e.getBoundingClientRect().right > innerWidth + 0.5).map(e => e.textContent)"


def small(example, folder, *replacements):
    """The example's study with little training: the page is what is tested."""
    text = (ROOT / "examples" / f"{example}.toml").read_text()
    text = re.sub(r"(?m)^runs = \d+", "runs = 100", text)
    text = re.sub(r"(?m)^epochs = \d+", "epochs = 4", text)
    for old, new in replacements:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / f"{example}.toml"
    path.write_text(text + ANY)
    return path


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    pages = {}
    for example in FIGURES:
        study = small(example, folder)
        out = folder / example
        for verb in ("sample", "train"):
            metafmu(verb, study, "--out", out)
        metafmu("compare", study, "--out", out, "--model", "ridge", "--model", "lasso", "--model", "decision-tree")
        extra = []
        if example == "single-pendulum":
            other = small(example, out, ("hidden = [64, 64, 64, 64, 64, 64]", "hidden = [8]"), ('"single-pendulum"    # names', '"other"    # names'))
            for verb in ("sample", "train"):
                metafmu(verb, other, "--out", out / "other")
            extra = ["--beside", other, "--beside-out", out / "other", "--plots", out / "plots"]
        metafmu("report", study, "--out", out, *extra)
        pages[example] = out / "report.html"
    return pages


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("example", FIGURES)
def test_the_page_fits_the_window_and_asks_for_nothing(browser, reports, example, size):
    requests = show(browser, reports[example], size)
    assert [url for url in requests if not url.startswith("data:")] == [reports[example].as_uri()]
    assert browser.get_log("browser") == []
    assert browser.execute_script("return innerWidth") == size[0]
    assert browser.execute_script("return document.documentElement.scrollWidth") <= size[0]
    assert browser.execute_script(CUT) == []

    figures = browser.execute_script(LOOK_AT_FIGURES)
    found = [figure["id"] for figure in figures]
    assert len(set(found)) == len(found)
    assert [name for name in FIGURES[example] if name not in found] == []
    for figure in figures:
        assert figure["outside"] == [] and figure["overlapping"] == [], figure
        assert figure["caption"] and figure["label"] and figure["marks"] > 3, figure
        assert figure["smallest"] >= 9.5, figure
        axes = [text for text in figure["texts"] if re.search(r"[a-zR]", text) and not re.fullmatch(r"-?[\d.]+e-?\d+", text)]
        assert len(axes) >= 2, figure


@pytest.mark.parametrize("size", [DESKTOP, PHONE, SMALL_PHONE], ids=["desktop", "phone", "small-phone"])
def test_the_model_card_shows_two_plots_and_stays_small(browser, reports, size):
    folder = reports["slider-crank"].parent
    study = folder.parent / "slider-crank.toml"
    metafmu("evaluate", study, "--out", folder)
    metafmu("export", study, "--out", folder)
    with zipfile.ZipFile(folder / "slider-crank.fmu") as archive:
        archive.extract("documentation/index.html", folder)
    card = folder / "documentation" / "index.html"
    assert card.stat().st_size < 100_000
    assert show(browser, card, size) == [card.as_uri()]
    assert browser.execute_script("return document.documentElement.scrollWidth") <= size[0]
    assert browser.execute_script(CUT) == []
    figures = browser.execute_script(LOOK_AT_FIGURES)
    assert len(figures) == 2
    assert all(figure["outside"] == [] and figure["overlapping"] == [] for figure in figures)


@pytest.fixture(scope="module")
def studies(tmp_path_factory):
    """Dynamics of a mechanism, noisy rows of a table, and a surrogate that is rejected: pages after a build."""
    folder = tmp_path_factory.mktemp("studies")
    shutil.copytree(ROOT / "examples" / "dynamics", folder / "dynamics")
    crane = folder / "dynamics" / "crane-study.toml"
    text = crane.read_text().replace("stop = 60.0", "stop = 10.0")
    crane.write_text(text)
    random = np.random.default_rng(1)
    x = random.uniform(size=(80, 2))
    rows = np.column_stack([x, np.sin(3 * x[:, 0]) + x[:, 1] ** 2 + random.normal(scale=0.02, size=80)])
    np.savetxt(folder / "noisy.csv", rows, delimiter=",", header="x,y,z", comments="", fmt="%.6f")
    noisy = folder / "noisy.toml"
    noisy.write_text('name = "noisy"\nstructure = "static"\n[source]\ntable = "noisy.csv"\n[inputs]\nx = {}\ny = {}\n'
                     "[outputs]\nz = {}\n[bounds]\ncoverage = 0.9\n")
    rejected = small("single-pendulum", folder)
    rejected.write_text(rejected.read_text().replace(ANY, "").replace('name = "single-pendulum"', 'name = "rejected"'))
    pages = {}
    for name, study in {"crane": crane, "noisy": noisy, "rejected": rejected}.items():
        done = metafmu("build", study, "--out", folder / name, check=False)
        assert done.returncode == (1 if name == "rejected" else 0), done.stderr
        pages[name] = folder / name / "report.html"
    return pages


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("name", ["single-pendulum", "crane", "noisy", "rejected"])
def test_the_first_screen_answers(browser, reports, studies, name, size):
    """Verdict, accuracy, worst and median run, ranges and cost: nobody scrolls for them."""
    page = studies[name] if name in studies else reports[name]
    show(browser, page, size)
    found = browser.execute_script(FIRST_SCREEN, PARTS)
    for selector, parts in found.items():
        assert len(parts) == {".strip": 1 if name == "noisy" else 2}.get(selector.split(" ")[0], 1), selector
        for part in parts:
            assert part["bottom"] <= size[1] and part["width"] > 60 and part["height"] > 15 and part["seen"], (selector, part)
    text = {selector: " ".join(part["text"] for part in parts) for selector, parts in found.items()}
    assert text[".verdict"].startswith("Rejected: this surrogate is not good enough" if name == "rejected" else ("Good", "Usable")), text[".verdict"]
    if name == "rejected":
        assert "expected at least" in text[".verdict"]
    ranges, cost = {
        "single-pendulum": ("L 0.1 to 0.2 m", "not measured"),
        "crane": ("l 1 to 2 m", "a step of 0.05 s on one core"),
        "noisy": ("x 0.0", "a row on one core, a table is no source to compare with"),
        "rejected": ("L 0.1 to 0.2 m", "a step of 0.01 s on one core"),
    }[name]
    assert ranges in text[".ranges"] and text[".ranges"].startswith("Trained for" if name == "rejected" else "Valid for"), text[".ranges"]
    assert cost in text[".cost"], text[".cost"]
    assert ("as its source" in text[".cost"] or "than its source" in text[".cost"]) == (name in ("crane", "rejected"))
    metrics = page.parent / "metrics.json"
    if metrics.exists() and name != "single-pendulum":
        metrics = json.loads(metrics.read_text())
        worst = max(metrics["outputs"].values(), key=lambda output: output["relative_max_error"] or 0)
        assert f"{'row' if name == 'noisy' else 'run'} {worst['worst_run'] + (name == 'noisy')}" in text[".accuracy"]
        cells = browser.execute_script("return [...document.querySelectorAll('.accuracy [data-heading=R²]')].map(cell => cell.textContent)")
        # next to 1 the page has the difference: 1 - 3 × 10⁻¹⁵
        shown = [float(cell.split("\u00a0")[0]) for cell in cells]
        assert shown == pytest.approx([output["r2"] for output in metrics["outputs"].values()], abs=1e-4)
    if name == "crane":
        drawing = browser.execute_script(FIRST_SCREEN, [".mechanism svg", ".mechanism .body", ".mechanism .block"])
        assert drawing[".mechanism svg"][0]["bottom"] <= size[1], drawing
        assert len(drawing[".mechanism .body"]) == 2 and len(drawing[".mechanism .block"]) == 1
    else:
        assert "class=\"mechanism\"" not in page.read_text()
    assert browser.execute_script(CUT) == []
    assert browser.get_log("browser") == []


def test_the_mechanism_moves_and_stops_at_the_worst_instant(browser, studies):
    show(browser, studies["crane"], DESKTOP)
    pose = "return document.querySelector('.mechanism .body').getAttribute('transform')"
    button = "document.querySelector('.mechanism button').click(); "
    # without a script it would stay at the worst instant
    assert len({browser.execute_async_script(f"const done = arguments[0]; setTimeout(() => done((() => {{ {pose} }})()), 150)") for _ in range(4)}) > 2
    still = browser.execute_script(button + pose)
    assert still in studies["crane"].read_text() and browser.execute_script(pose) == still
    assert browser.execute_script(button + pose) is not None


def test_the_page_is_complete_without_scripts(browser, studies):
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        show(browser, studies["crane"], DESKTOP)
        shown = browser.find_elements("css selector", ".first .strip, .first .mechanism svg, .first .accuracy")
        assert len(shown) == 4 and all(part.is_displayed() for part in shown)
    finally:
        browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


def test_keys_go_from_section_to_section(browser, reports):
    show(browser, reports["single-pendulum"], DESKTOP)
    top = "return Math.round(document.querySelectorAll('section')[arguments[0]].getBoundingClientRect().top)"
    body = browser.find_element("css selector", "body")
    body.send_keys("n")
    assert abs(browser.execute_script(top, 0)) <= 2
    body.send_keys("n")
    assert abs(browser.execute_script(top, 1)) <= 2
    body.send_keys("p")
    assert abs(browser.execute_script(top, 0)) <= 2
    body.send_keys("t")
    assert browser.execute_script("return scrollY") == 0


# contrast of the texts of the first screen with what is behind them, by WCAG 2
CONTRAST = """
const parse = color => { const c = document.createElement('canvas').getContext('2d'); c.fillStyle = color; c.fillRect(0, 0, 1, 1); return [...c.getImageData(0, 0, 1, 1).data]; };
const luminance = ([r, g, b]) => [r, g, b].map(v => v / 255).map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4).reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
const paper = luminance(parse(getComputedStyle(document.body).backgroundColor));
return [...document.querySelectorAll('.first *, nav a, td, th, h2, section p')].filter(e => e.textContent.trim() && !e.closest('svg')).map(e => {
    const ink = luminance(parse(getComputedStyle(e).color));
    return [(Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05), e.tagName, e.textContent.slice(0, 40)];
}).filter(([ratio]) => ratio < 4.5);
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_are_legible_in_both_schemes(browser, reports, studies, scheme):
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    try:
        for page in (reports["single-pendulum"], studies["rejected"]):
            show(browser, page, DESKTOP)
            browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
            paper = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
            assert paper == ("rgb(20, 26, 33)" if scheme == "dark" else "rgb(255, 255, 255)")
            assert browser.execute_script(CONTRAST) == []
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_axes_have_names_and_units(browser, reports):
    show(browser, reports["single-pendulum"], DESKTOP)
    texts = {figure["id"]: figure["texts"] for figure in browser.execute_script(LOOK_AT_FIGURES)}
    for figure, names in {
        "median-theta": ["time [s]", "theta [rad]", "truth", "prediction"],
        "density-thetadd": ["thetadd, label [rad/s2]", "thetadd, prediction [rad/s2]"],
        "phase-median-theta": ["theta [rad]", "thetad [rad/s]"],
        "path-worst-mass": ["x [m]", "y [m]"],
        "error-time-thetad": ["time [s]", "error of thetad [rad/s]"],
        "error-c-relative": ["c [kg.m/s]", "RMS error / range"],
        "sensitivity-theta": ["change of theta [rad]", "time [s]"],
        "training-loss": ["epoch", "loss"],
    }.items():
        assert set(names) <= set(texts[figure]), figure


def test_the_page_prints_without_cutting_anything(browser, reports):
    """As PDF on A4: every page is there and no figure is wider than the paper."""
    show(browser, reports["slider-crank"], DESKTOP)
    pdf = browser.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69, "printBackground": False})
    assert len(pdf["data"]) > 100_000
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    show(browser, reports["slider-crank"], (718, 1000))
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 718
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_plots_are_files_too(reports):
    page = reports["single-pendulum"].read_text()
    plots = sorted((reports["single-pendulum"].parent / "plots").glob("*.svg"))
    assert len(plots) == page.count("<figure")
    assert all(plot.read_text().startswith("<svg") and plot.read_text() in page for plot in plots)


def test_the_report_has_the_same_bytes_on_any_number_of_threads(reports, monkeypatch):
    page = reports["slider-crank"]
    command = ["report", page.parent.parent / "slider-crank.toml", "--out", page.parent]
    # the speed, which other tests may have measured since, is on the page
    metafmu(*command)
    before = page.read_bytes()
    monkeypatch.setenv("RAYON_NUM_THREADS", OTHER_THREADS["RAYON_NUM_THREADS"])
    metafmu(*command)
    assert page.read_bytes() == before


def test_figures_of_the_page_are_those_of_metrics_json(reports):
    page = reports["double-pendulum"]
    metafmu("evaluate", page.parent.parent / "double-pendulum.toml", "--out", page.parent)
    metrics = json.loads((page.parent / "metrics.json").read_text())
    for output in metrics["outputs"].values():
        nines = max(4, int(np.floor(-np.log10(1 - output["r2"]))) + 2)
        assert f"<td data-heading=\"R²\">{output['r2']:.{nines}f}</td>" in page.read_text()


def test_what_cannot_stand_beside_is_refused(reports):
    page = reports["single-pendulum"]
    study, other = page.parent.parent / "single-pendulum.toml", page.parent.parent / "double-pendulum.toml"
    result = metafmu("report", study, "--out", page.parent, "--beside", other, check=False)
    assert result.returncode == 2 and "expected those of single-pendulum: L [m], c [kg.m/s], thetad0 [rad/s]" in result.stderr
    seen = page.parent / "seen.toml"
    points = [line.split(",")[2:5] for line in (page.parent / "test.csv").read_text().splitlines()]
    (page.parent / "points.csv").write_text("\n".join(sorted({",".join(row) for row in points}, reverse=True)))
    text = study.read_text().replace('method = "sobol"', 'method = "list"\nfile = "points.csv"')
    seen.write_text(re.sub(r"(?m)^(runs|faces) = .*\n", "", text))
    result = metafmu("report", study, "--out", page.parent, "--beside", seen, check=False)
    assert result.returncode == 2 and "was trained on 200 of the test runs of single-pendulum" in result.stderr
