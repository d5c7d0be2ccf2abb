"""Text of docs/paper.md: a row for each table, figure and claim of paper.toml, from the values of results.json."""

import math
import tomllib
from collections import Counter
from pathlib import Path

import paper_models as models

FILE = Path(__file__).with_name("paper.toml")
LISTED = tomllib.loads(FILE.read_text(encoding="utf-8"))
FULL = {"double-pendulum-full", "search-full"}
# of cases in pictures
COLORS = ("blue", "orange", "green", "pink", "sky blue")
# columns of the outputs that the paper names
SLIDER_NAMED = (0, 1, 3, 4, 5)
INTRODUCTION = """# The paper, repeated

This page says which tables, figures and claims of Choi et al. 2021 metafmu repeats, with which values, and how to repeat them:

    .venv/bin/python scripts/measure paper            # 20 minutes on two idle cores
    .venv/bin/python scripts/measure paper --full     # also what takes hours

The paper is H.-S. Choi et al., *Data-driven simulation for general purpose multibody dynamics using deep neural networks*, Multibody System
Dynamics 51 (2021). Tables and figures are numbered in the order of its text. *Its recipe* is the paper's own: its mesh, network, batch, epochs and
optimizer (`examples/paper/`). *Our default* is what `metafmu new` writes (`examples/*.toml`). S_full is one network with the time as an input;
S_fixed has [a network for each time point](structures.md). R² and MSE are those of 200 unseen random runs.

The column *holds* judges by the values of the paper's recipe, and has a dash where the paper states nothing to judge. S_fixed oscillates if it is
twice as rough as S_full.

*Roughness* is the root mean square of the error's second differences in time, e(t-h) - 2 e(t) + e(t+h), over that of the truth: 0 is as smooth as
the truth. The values here are the largest of all outputs.
"""
COST = """
Both searches pass the same rows through the same networks equally often: S_fixed has 201 networks of 1,331 rows, S_full one of 267,531 rows.
A factor other than 1 comes from the program: 201 times as many starts, against rows that fit into a cache. The fewer the epochs, the more a start
counts.
[One training of 400 epochs](structures.md#the-papers-recipe) has the same ratio without a search.
"""
UNSTATED = """
## Details that the paper does not state

Values can differ from the paper's for these reasons alone.

| detail | assumed here |
|---|---|
"""
SLIPS = """
The paper's Tables 1 and 2 print other parameters than those of their rows, and a row of Table 2 is a copy of another. Table 4 and the captions of
Figures 5 and 6 print `c` and `thetad0` in each other's column. Its MSE values are parts of pictures and are not compared.
"""


def score(r2):
    """R² with two digits of its distance to 1."""
    missing = 1 - r2
    return f"{r2:.{min(12, max(3, 1 - math.floor(math.log10(missing))))}f}" if missing > 0 else "1"


def short(value):
    """A small number with two digits."""
    return f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e") if not 0.01 <= abs(value) < 100 else f"{value:.2g}"


def ratio(new, old):
    return None if None in (new, old) else new / old


def listed(values):
    return ", ".join(map(short, values))


def thousands(number):
    return f"{number:,}"


def recipe_of(text):
    """Network and training of a study, as the paper's tables have them."""
    study = tomllib.loads(text)
    network, training = study["network"], study["training"]
    size = f"{len(network['hidden'])} x {network['hidden'][0]} {network['activation']}"
    at_most = "at most " if training.get("schedule") == "restarts" else ""
    return f"{size}, batch {training['batch']}, {at_most}{training['epochs']} epochs, {training['optimizer'].upper() if training['optimizer'] == 'soap' else 'Adam'}"


def worst(values):
    return score(min(values))


def largest(values):
    return short(max(values))


def command_of(part):
    """Option that measures a part."""
    return "`--full`" if part in FULL else f"`--only {part}`"


class Cells:
    """Values of rows: two texts by the name of a row, the paper's recipe and our default."""

    def __init__(self, results):
        self.results = results
        self.double = results.get("double-pendulum-full", results.get("double-pendulum"))
        self.is_full = "double-pendulum-full" in results

    def known(self, name, row):
        """Values of the part of a row, None if it was not measured."""
        part = row.get("part")
        if part == "double-pendulum":
            return self.double
        return self.results.get("search-full" if name in ("search-cost", "table-6") and "search-full" in self.results else part)

    def of(self, name, row):
        """Both cells of a row."""
        if "ours" in row:
            return row["ours"], "the same" if "picture" in row else "-"
        known = self.known(name, row)
        if known is None:
            return (f"not measured: {command_of(row['part'])}",) * 2
        return getattr(self, name.replace("-", "_"))(known)

    def epochs(self):
        """Remark on a shorter training of the double pendulum."""
        return "" if self.is_full else f" ({models.FEW_EPOCHS} of 400 epochs)"

    def every(self):
        """Remark on fewer networks of the double pendulum."""
        return "" if self.is_full else f", a network each {models.LONG_STEP:g} s"

    # claims
    def pendulum_r2(self, known):
        return worst(known["full"]["r2"]), worst(known["default"]["r2"])

    def double_r2(self, known):
        return worst(known["full"]["r2"]) + self.epochs(), worst(known["default"]["r2"])

    def slider_r2(self, known):
        named = lambda kind: [known[kind]["r2"][number] for number in SLIDER_NAMED]
        return worst(named("full")), worst(named("default"))

    def slider_best(self, known):
        parts = {"slider crank": known, "pendulum": self.results.get("single-pendulum"), "double pendulum": self.double}
        text = lambda kind: ", ".join(f"{name} {short(1 - min(part[kind]['r2']))}" for name, part in parts.items() if part)
        return text("full") + (self.epochs() if self.double else ""), text("default")

    def smooth(self, known):
        rough = lambda kind: largest(known[kind]["roughness"])
        return f"roughness: S_fixed {rough('fixed')}, S_full {rough('full')}", f"S_full {rough('default')}"

    def pendulum_smooth(self, known):
        return self.smooth(known)

    def slider_smooth(self, known):
        return self.smooth(known)

    def double_smooth(self, known):
        recipe, default = self.smooth(known)
        return f"{recipe}{self.epochs()}{self.every()}", default

    def double_late(self, known):
        late = lambda kind: largest(known[kind]["late"])
        return f"last fifth over first fifth of the time: S_fixed {late('fixed')}, S_full {late('full')} times as rough", f"S_full {late('default')} times"

    def search_gain(self, known):
        single = self.results.get("single-pendulum")
        if single is None:
            return "not measured: `--only single-pendulum`", "-"
        gains = [before / after for before, after in zip(single["fixed"]["mse"], known["searched"]["mse"])]
        return f"MSE of `theta`, `thetad`, `thetadd` divided by {listed(gains)}", "-"

    def search_smooth(self, known):
        return f"roughness {largest(known['searched']['roughness'])}", "-"

    def search_cost(self, known):
        if known["cost"] is None:
            return "not measured: the trainings were interrupted", "-"
        return f"{known['cost']:.2g} ({known['trials']} trials, {known['epochs']} of 400 epochs each)", "-"

    def models(self, known):
        rows = known["rows"]
        return f"{rows['single-pendulum']['times']}, {rows['double-pendulum']['times']}", "1, 1"

    def real_time(self, known):
        text = lambda kind: f"a step of 10 ms takes {known['step_us'][kind]:.0f} µs through fmpy"
        return text("full"), text("default")

    def batch(self, known):
        if known["batch"] is None:
            return "not measured: the trainings were interrupted", "-"
        return f"batches of 1024 take {known['batch']:.2g} times the processor time of batches of 64", "batches of 1024"

    def activations(self, known):
        errors = ", ".join(f"{name} {short(known[f'activation {name}'])}" for name in ("tanh", "sigmoid", "relu"))
        return f"1 - R² after {models.COMPARED_EPOCHS} of 400 epochs: {errors}", "tanh"

    def depth(self, known):
        errors = ", ".join(f"{name} {short(known[f'shape {name}'])}" for name in models.SHAPES)
        return f"1 - R² after {models.COMPARED_EPOCHS} of 400 epochs: {errors}", "6 x 64"

    # tables
    def table_1(self, known):
        return f"largest difference {short(known['table-1'])}, with `L` = 0.1, `c` = 0, 0.01, 0.02, `thetad0` = 0", "the same data"

    def table_2(self, known):
        return f"{known['table-2']} of 9 rows agree, with the same parameters as in Table 1", "the same data"

    def table_3(self, known):
        return recipe_of(models.recipe("single-pendulum")), recipe_of(models.default("single-pendulum"))

    def table_7(self, known):
        return recipe_of(models.recipe("double-pendulum")), recipe_of(models.default("double-pendulum"))

    def table_10(self, known):
        return recipe_of(models.recipe("slider-crank")), recipe_of(models.default("slider-crank"))

    def of_cases(self, known, cases):
        error = lambda kind: largest(known[kind]["cases_mse"][case][output] for case in cases for output in range(len(known[kind]["r2"])))
        return f"largest MSE of an output: S_fixed {error('fixed')}, S_full {error('full')}", f"S_full {error('default')}"

    def table_4(self, known):
        return self.of_cases(known, range(1, 5))

    def table_8(self, known):
        recipe, default = self.of_cases(known, range(5))
        return recipe + self.epochs(), default

    def table_5(self, known):
        counts = Counter((len(hidden), hidden[0]) for hidden, _ in known["chosen"])
        chosen = ", ".join(f"{layers} x {nodes} at {count}" for (layers, nodes), count in sorted(counts.items()))
        batches = Counter(batch for _, batch in known["chosen"])
        return f"{chosen} time points; batch 64 at {batches[64]}, 128 at {batches[128]}", "-"

    def table_6(self, known):
        rows = self.results.get("samples", {}).get("rows", {}).get("single-pendulum")
        if rows is None or known["cost"] is None:
            return "not measured: `--only samples search`", "-"
        return f"1, {thousands(rows['rows'])} rows, 1; {rows['times']}, {thousands(rows['runs'])} rows, {known['cost']:.2g}", "-"

    def mesh(self, known, system):
        rows = known["rows"][system]
        return f"{thousands(rows['runs'])} runs of {rows['times']} times: {thousands(rows['rows'])} rows"

    def table_9(self, known):
        return self.mesh(known, "double-pendulum"), "8,192 Sobol runs" if "runs = 8192" in models.default("double-pendulum") else "Sobol runs"

    def table_11(self, known):
        return self.mesh(known, "slider-crank"), "1,331 Sobol runs" if "runs = 1331" in models.default("slider-crank") else "Sobol runs"

    # figures
    def scores(self, known):
        text = lambda kind: f"R² {', '.join(map(score, known[kind]['r2']))}"
        return text("full"), text("default")

    def errors(self, known, cases, outputs):
        mse = lambda kind: listed(sum(known[kind]["cases_mse"][case][output] for case in cases) / len(cases) for output in outputs)
        return f"MSE S_fixed {mse('fixed')}; S_full {mse('full')}", f"MSE {mse('default')}"

    def figure_4(self, known):
        return self.scores(known)

    def figure_5(self, known):
        return self.errors(known, [0], range(3))

    def figure_6(self, known):
        return self.errors(known, [1, 2, 3, 4], range(3))

    def figure_7(self, known):
        mse = [sum(known["searched"]["cases_mse"][case][output] for case in range(5)) / 5 for output in range(3)]
        return f"MSE {listed(mse)}", "-"

    def figure_9(self, known):
        recipe, default = self.scores(known)
        return recipe + self.epochs(), default

    def figure_10(self, known):
        recipe, default = self.errors(known, range(5), (0, 2))
        return recipe + self.epochs(), default

    def figure_11(self, known):
        recipe, default = self.errors(known, range(5), (1, 3))
        return recipe + self.epochs(), default

    def figure_12(self, known):
        recipe, default = self.errors(known, (1, 4, 5), (0, 1))
        return recipe + self.epochs(), default

    def figure_14(self, known):
        return self.scores(known)

    def figure_15(self, known):
        return self.errors(known, [0], (4, 5, 6))

    def figure_16(self, known):
        return self.errors(known, [0], (1, 2, 3))

    def figure_17(self, known):
        return self.errors(known, [0], (4, 5, 6))


class Judgments:
    """Statements of the paper that values can contradict: True or False by the name of a row, from what its part measured with the paper's recipe."""

    def __init__(self, results):
        self.results = results

    def of(self, name, row, known):
        """Text of the column `holds`."""
        judge = getattr(self, name.replace("-", "_"), None)
        if "holds" in row:
            return row["holds"]
        return "-" if known is None or judge is None else "yes" if judge(known) else "no"

    # claims
    def pendulum_r2(self, known):
        return min(known["full"]["r2"]) > 0.9965

    def double_r2(self, known):
        return min(known["full"]["r2"]) > 0.997

    def slider_r2(self, known):
        return min(known["full"]["r2"][number] for number in SLIDER_NAMED) > 0.999

    def slider_best(self, known):
        """The paper's pendulums miss three times as much of R² as its slider crank."""
        pendulums = [self.results.get("single-pendulum"), self.results.get("double-pendulum-full", self.results.get("double-pendulum"))]
        missing = 1 - min(known["full"]["r2"])
        return all(pendulum is not None and 1 - min(pendulum["full"]["r2"]) > 3 * missing for pendulum in pendulums)

    def oscillates(self, known):
        return max(known["fixed"]["roughness"]) > 2 * max(known["full"]["roughness"])

    pendulum_smooth = double_smooth = slider_smooth = oscillates

    def double_late(self, known):
        return max(known["fixed"]["late"]) > 2 * max(known["full"]["late"])

    def search_gain(self, known):
        """By an order of magnitude for each output."""
        single = self.results.get("single-pendulum")
        return single is not None and all(before > 10 * after for before, after in zip(single["fixed"]["mse"], known["searched"]["mse"]))

    def search_smooth(self, known):
        single = self.results.get("single-pendulum")
        return single is not None and max(known["searched"]["roughness"]) > 2 * max(single["full"]["roughness"])

    def search_cost(self, known):
        """Within a tenth of the paper's."""
        return known["cost"] is not None and abs(known["cost"] / 18.3458 - 1) < 0.1

    def models(self, known):
        return [known["rows"][system]["times"] for system in ("single-pendulum", "double-pendulum")] == [201, 501]

    def real_time(self, known):
        return known["step_us"]["full"] < 10_000

    def batch(self, known):
        return known["batch"] is not None and known["batch"] < 1

    def activations(self, known):
        """Each is as accurate as the paper's pendulum."""
        return all(known[f"activation {name}"] < 0.003 for name in ("tanh", "sigmoid", "relu"))

    def depth(self, known):
        errors = [known[f"shape {name}"] for name in models.SHAPES]
        return errors == sorted(errors, reverse=True)

    # tables
    def table_1(self, known):
        return known["table-1"] < 5.1e-6

    def table_2(self, known):
        return known["table-2"] == 9

    def table_5(self, known):
        """Time points differ in their best options."""
        return len({str(options) for options in known["chosen"]}) > 1

    def table_6(self, known):
        return self.search_cost(known)

    def table_9(self, known):
        return known["rows"]["double-pendulum"]["rows"] == 7_335_141

    # figures
    figure_4, figure_9 = pendulum_r2, double_r2

    def figure_14(self, known):
        return min(known["full"]["r2"]) > 0.999


def table(kind, heading, cells, judgments):
    text = f"\n## {heading}\n\n| {kind[:-1]} | the paper | its recipe | our default | holds |\n|---|---|---|---|---|\n"
    for name, row in LISTED[kind].items():
        text += f"| {row['title']} | {row['paper']} | {' | '.join(cells.of(name, row))} | {judgments.of(name, row, cells.known(name, row))} |\n"
    return text


def tables(results):
    """The three tables of the page."""
    cells, judgments = Cells(results), Judgments(results)
    claims, listed, figures = (table(kind, kind.capitalize(), cells, judgments) for kind in ("claims", "tables", "figures"))
    return claims + COST + listed + figures


def is_drawn(row, results):
    """Returns True if the part that draws the picture of a row was measured."""
    part = row.get("part", "samples")
    return part in results or f"{part}-full" in results


def caption(name, row):
    """Sentences under a picture: what it is, and its cases by color."""
    if name == "systems":
        return "Figures 3, 8 and 13: the three systems."
    text = row["title"] + "."
    if "cases" in row:
        system = row["part"].removesuffix("-fixed")
        names = ", ".join(f"`{parameter}`" for parameter in tomllib.loads(models.recipe(system))["parameters"])
        values = lambda case: ", ".join(f"{value:g}" for value in models.CASES[system][case])
        colors = ("top", "middle", "bottom") if name == "double-paths" else COLORS if len(row["cases"]) > 1 else [""]
        text += f" Values of {names}: " + "; ".join(f"{color} {values(case)}".strip() for color, case in zip(colors, row["cases"])) + "."
    return text


def pictures(results):
    """Every picture with its figures."""
    text, shown = "", set()
    for system, heading in {"systems": "The systems", "single": "Pendulum", "double": "Double pendulum", "slider": "Slider crank"}.items():
        text += f"\n## {heading}\n"
        for row in LISTED["figures"].values():
            name = row.get("picture", "")
            if name.split("-")[0] != system or name in shown:
                continue
            shown.add(name)
            about = "The three systems" if name == "systems" else row["title"].split(": ")[1]
            text += f"\n{caption(name, row)}\n\n"
            text += f"![{about}](paper/{name}.svg)\n" if is_drawn(row, results) else f"Not drawn: {command_of(row.get('part', 'samples'))} draws it.\n"
    return text


def records(results):
    """Commit and date of each part."""
    text = "\n## Measured\n\nEach part has its commit and date. Parts of `--full` keep them until the next full run.\n\n| part | commit | date |\n|---|---|---|\n"
    return text + "".join(f"| `{name}` | {values['commit']} | {values['date']} |\n" for name, values in results.items())


def document(results):
    """The page."""
    details = "".join(f"| {row['title']} | {row['assumed']} |\n" for row in LISTED["details"].values())
    return INTRODUCTION + tables(results) + UNSTATED + details + SLIPS + pictures(results) + records(results)
