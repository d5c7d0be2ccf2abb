"""The report in a browser, on a desktop and on a phone: complete, legible, and alone with itself."""

import json
import re
import zipfile

import pytest
from conftest import ANY, OTHER_THREADS, ROOT, metafmu
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

# (width, height) in CSS pixels
DESKTOP, PHONE, SMALL_PHONE = (1200, 900), (390, 844), (320, 568)
FIGURES = {
    "single-pendulum": ["density-theta", "histogram-thetadd", "median-theta", "worst-thetad", "cases-theta", "phase-worst-theta",
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


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for argument in ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-component-update",
                     "--disable-background-networking", "--disable-sync", f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"]:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, Service("/usr/bin/chromedriver"))
    yield driver
    driver.quit()


def show(browser, page, size):
    """Opens the page in a window of this size; returns what the page requested."""
    width, height = size
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": size != DESKTOP}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    # a new window has a separate page
    browser.get("about:blank")
    browser.get_log("performance")
    browser.get_log("browser")
    browser.get(page.as_uri())
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    return [message["params"]["request"]["url"] for message in messages if message["method"] == "Network.requestWillBeSent"]


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
        assert f"<td data-heading=\"R²\">{output['r2']:.7f}</td>" in page.read_text()


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
