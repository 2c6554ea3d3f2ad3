"""The commands that run one stage, in the order of the chain: what the help says about them."""

from __future__ import annotations

from dataclasses import dataclass

START, DATA, CHAIN, TRUST, LOOK = "Start", "Measured data", "The chain, in order", "Can the result be trusted?", "Look"


@dataclass(frozen=True)
class Entry:
    """Help of a stage: its name, its panel in the overview, one line, the details, and an example."""

    name: str
    panel: str
    line: str
    details: str
    example: str
    spread: bool = False
    """True where it solves many independent problems, which --jobs or --scheduler spread."""
    adds: bool = False
    """True where it adds effects to the model, as many as --max-effects lets it."""
    refines: bool = False
    """True where --refine asks for the errors of mesh and steps."""
    draws: bool = False
    """True where --also gives its figures in further formats."""
    picks: bool = False
    """True where --pick opens a window to click landmarks in."""

    @property
    def help(self) -> str:
        """Text of `thermofit NAME --help`, rich markup."""
        return f"{self.line}\n\n{self.details}"

    @property
    def epilog(self) -> str:
        """The example."""
        return f"[bold]Example:[/] thermofit {self.example}"


STAGES: tuple[Entry, ...] = (
    Entry(
        "simulate",
        CHAIN,
        "Make a virtual experiment: truth to noisy raw files.",
        "Solves the section 'simulate' of the study and writes RUN_DIR/raw in the format of a measured experiment: force, DIC points and "
        "infrared frames. They have noise, lost points, rigid-body motion of machine and jaws, a rolled and mirrored camera, and clocks of "
        "their own. Only for studies without a measured 'experiment'.",
        "simulate study.yaml --set simulate.seed=2",
    ),
    Entry(
        "calibrate-ir",
        CHAIN,
        "Pixels of the infrared camera to coordinates in mm.",
        "Algorithm 1: reads the infrared frames and their landmarks, finds scale, centre and axes of the specimen, refines them on its "
        "visible edges, and draws RUN_DIR/calibrate-ir.png: look at it. Without landmarks it finds them itself where the frames show "
        "edges and a shoulder. Given ones are compared with what is found. --pick opens a window to click them in.",
        "calibrate-ir study.yaml --pick --length-mm 60",
        picks=True,
    ),
    Entry(
        "interpolate",
        CHAIN,
        "Fields at material points of the mesh, with their noise.",
        "Algorithms 2 and 3: takes the DIC points and the pixels to the nodes of the evaluation window; temperatures at the current "
        "position of each node. "
        "Points without data are left out and counted, never extrapolated. The force is smoothed to its noise level, phase by phase.",
        "interpolate study.yaml --set evaluation.window.abs_y_max=15",
    ),
    Entry(
        "identify-elastic",
        CHAIN,
        "E and nu from displacements of the elastic range.",
        "The elastic range is found from the data, or given as stages.elastic.window. Rigid-body motion is taken out (channel du).",
        "identify-elastic study.yaml --set 'stages.elastic.window=[0, 7.5]'",
    ),
    Entry(
        "identify-plastic",
        CHAIN,
        "Yield limit, hardening, Hill's F from displacements.",
        "Needs the result of identify-elastic. A killed run resumes: finished evaluations are kept in RUN_DIR.",
        "identify-plastic study.yaml --set stages.plastic.method=nelder-mead",
    ),
    Entry(
        "identify-thermal",
        CHAIN,
        "Thermal parameters from the temperatures.",
        "Needs the results of identify-elastic and identify-plastic, whose parameters are kept. Any subset of alpha_exp, kappa, c0, beta, "
        "alpha_air, alpha_clamp is identified.",
        "identify-thermal study.yaml --set 'stages.thermal.free=[beta, c0]'",
    ),
    Entry(
        "refine",
        CHAIN,
        "All parameters in one fit of all channels, with combined uncertainty.",
        "From where the stages ended. Readings of thermocouples are data with an error. Force noise, mesh and time steps are in the "
        "uncertainty. So is what the section 'uncertainty' states of calibration and dimensions. "
        "`thermofit show RUN_DIR/refine.h5 --budget` "
        "shows its parts.",
        "refine study.yaml --set uncertainty.force_class=0.5",
    ),
    Entry(
        "gridsearch",
        TRUST,
        "Other starts: is the optimum the only one?",
        "Starts are listed or drawn in the section 'gridsearch' of the study. The verdict is unique, several optima, or valley with the "
        "relation of the parameters along it. A start that fails is counted and named. Starts run side by side in --jobs processes or on "
        "a Dask --scheduler. A killed search resumes.",
        "gridsearch study.yaml --jobs 2",
        spread=True,
    ),
    Entry(
        "sensitivity",
        TRUST,
        "Other boundary values: how far do parameters move?",
        "How far do the identified parameters move if, say, the temperature of the jaws is 0.1 K off? Quantity and values are in the "
        "section 'sensitivity' of the study. Each value is identified anew; beside it stands the linearised answer.",
        "sensitivity study.yaml --set 'sensitivity.values=[296.6, 296.8]' --jobs 2",
        spread=True,
    ),
    Entry(
        "verify",
        TRUST,
        "All parameters in one coupled run against all data.",
        "Residuals per channel and per phase of the test beside the noise, the error of one-way coupling, the energy balance. With "
        "--refine besides, in RUN_DIR/refinement.h5: the error of mesh and steps of every channel, with the order that refinements "
        "show, and how far it draws every parameter off.",
        "verify study.yaml --refine",
        refines=True,
    ),
    Entry(
        "report",
        LOOK,
        "A page to look at, figures and tables of a run.",
        "Writes RUN_DIR/report.html, one file that opens without a network, its JSON twin, the text of methods with references, "
        "RUN_DIR/figures and RUN_DIR/report.md. In place of a study it takes a run folder, also of a run that stopped half way: then it "
        "writes the page of what is there.",
        "report study.yaml",
        draws=True,
    ),
)

LOOP = "Close the loop"

ASIDE: tuple[Entry, ...] = (
    Entry(
        "diagnose",
        LOOP,
        "What does the residual still hold, and which effect would explain it?",
        "Fits everything that the stages identified at once, on all channels. Asks how the model would respond to every effect of the "
        "catalogue, physical or of the instruments. Ranks them by the held-out error that each would save. Effects that this test cannot "
        "tell apart are named together.",
        "diagnose study.yaml --json",
    ),
    Entry(
        "close-loop",
        LOOP,
        "Find, prove and add the effects that the model lacks.",
        "Adds the effect that lowers the error on held-out data most, refits everything, and goes on until nothing is accepted. "
        "Reports the error before and after, beside the noise, and writes RUN_DIR/with-effects.yaml.",
        "close-loop study.yaml --max-effects 2",
        adds=True,
    ),
    Entry(
        "mesh",
        LOOK,
        "The mesh of a study: checked, counted, drawn.",
        "Makes the mesh of the section 'geometry' (a built-in shape or a file), checks its Jacobians and free faces, and lists its "
        "sets. Draws RUN_DIR/mesh.png with every set in its colour: look at it before a long run.",
        "mesh study.yaml --set mesh=coarse",
    ),
    Entry(
        "necking",
        CHAIN,
        "Hardening law of a necking test without force.",
        "The section 'necking' of the study names the displacements of a grid of points, frame by frame. Equal force through every "
        "cross-section gives the Considere strain and the exponent of hardening; frames that were not fitted test the prediction. The "
        "only link of `thermofit run` in such a study.",
        "necking study.yaml --set 'necking.fit_frames=[0, 40]'",
    ),
)
"""Commands on a study that are no link of the chain of a full-field test."""

SPREAD: frozenset[str] = frozenset(entry.name for entry in (*STAGES, *ASIDE) if entry.spread)
"""Commands that --jobs and --scheduler spread."""

VALIDATE = Entry(
    "validate",
    TRUST,
    "Predict an experiment that no fit has seen.",
    "Predicts every experiment (or coupon record) with held_out: true, and every raw folder named with --experiment. The parameters are "
    "those identified on the others. The prediction is one coupled run, judged by its noise, as `verify` judges fitted data.",
    "validate study.yaml --experiment lab/test-08",
)
COMPARE = Entry(
    "compare",
    TRUST,
    "Models side by side on the same data: which one?",
    "Fits the model of the study, the candidates of its section 'compare' (another law, with or without effects), and those of further "
    "studies of the same data. All channels are fitted at once. Shows error, held-out error, AIC and BIC, with the number of independent "
    "data.",
    "compare study.yaml --set 'compare={model-1: {model: 1}}'",
)

INJECT = Entry(
    "inject",
    LOOP,
    "Would this test show an effect? Plant one into its data, and count.",
    "Adds what the fitted model predicts with an effect of the catalogue, less what it predicts without, to the measured data. Runs the "
    "loop of close-loop on them. Counts how often the effect comes out, or one that the test cannot tell from it, or something "
    "unlisted in the right channel, and how often something else does. With --count exponents, places, times and the sign are drawn, off "
    "the values that the loop scans. Of effects with a place and a begin it draws a map. The linear model predicts the share "
    "beforehand, and the smallest amplitude; --predict-only stops there. Finished runs are kept in RUN_DIR/inject.jsonl: a killed command "
    "resumes, and more draws cost only what is new.",
    "inject study.yaml --effect local_source --amplitude 0.5 --count 20",
)

REPORT = "report"
"""The one command that also takes a run folder."""
ON_CHAIN: tuple[str, ...] = ("diagnose", "close-loop")
"""Commands that first run the chain up to the last identification, as far as that is not done."""

ABOUT = (
    "Identify the parameters of thermo-mechanically coupled plasticity from a tension test with full-field measurements.\n\n"
    "thermofit fits a coupled finite element model to the raw files of a test: force, displacements from digital image correlation, "
    "temperatures from an infrared camera. Then it names what the model lacks, adds it, and shows the error before and after. "
    "`thermofit COMMAND --help` explains a command."
)

# Lines of a paragraph are kept as they are, so that a paragraph of prose is one line here.
MANUAL = "\n".join(
    (
        "[bold]An example session[/]",
        "  thermofit demo",
        "  thermofit new study.yaml --experiment lab/test-07",
        "  thermofit run study.yaml --set mesh=coarse",
        "  thermofit run study.yaml",
        "  thermofit close-loop study.yaml",
        "Try it on a small virtual test. Write a commented study file and set its starts and bounds. Run the chain on a coarse mesh, then "
        "on the fine one. Ask what the model lacks.",
        "",
        "[bold]Where results go[/]",
        "  RUN_DIR/<stage>.h5     one self-describing HDF5 file per stage",
        "  RUN_DIR/report.html    the report to look at; report.md and figures/ to copy from",
        "RUN_DIR is the key run_dir of the study (absent: runs/NAME) or --run-dir. A stage whose study, inputs and program are unchanged "
        "says 'fresh' and does nothing. A killed stage leaves its old result intact, and an identification resumes with the same command.",
        "",
        "[bold]Exit codes[/]",
        "  0   done",
        "  2   the command or the study file is wrong",
        "  3   the data are wrong",
        "  4   the numerics failed",
        "  5   done, but the answer is not to be trusted: the verdict says why",
        "Errors are one sentence on stderr. With --json the result, or the error, is JSON on stdout.",
    )
)

DATA_HELP = (
    "Public sets of measured data: list them, fetch them.\n\n"
    "Each file is known by GitHub project, commit, path and SHA-256, with its licence and how to cite it. A local mirror, the folder "
    "'real' of the folder that THERMOFIT_DATA names, is taken first; what is not there is downloaded."
)

INSPECT_HELP = (
    "What is this file or folder?\n\n"
    "Says format, encoding, separator and decimal sign. Lists columns with meaning and unit, and where the unit comes from. Counts points, "
    "stages, frames, missing values, gaps and repeated times. Estimates the noise of each channel, and names doubtful signs and clocks. "
    "Prints the lines to put into a study or an experiment.yaml. Files are recognised by content, not by name. A folder is listed by "
    "format and sequence."
)

RUN_HELP = (
    "All stages: raw files in, parameters and figures out.\n\n"
    "simulate (virtual experiments only), calibrate-ir (where there are infrared frames), interpolate, identify-elastic, "
    "identify-plastic, identify-thermal, refine (all of them in one fit), verify, report. Stages whose inputs are unchanged are fresh and "
    "cost nothing. Ends with a table of start and identified values with their combined standard uncertainty, and with the paths of the "
    "figures. True values stand beside where the experiment is virtual."
)

RUN_EXAMPLES = """[bold]Examples:[/]
thermofit run study.yaml
thermofit run study.yaml --from identify-plastic --until verify"""

DEMO_HELP = (
    "A small virtual test, identified from its raw files.\n\n"
    "Puts the study quickstart.yaml into a folder and runs it as `thermofit run` does: a minute, the kernels are compiled the first time. "
    "Read the study and change it: `thermofit run thermofit-demo/quickstart.yaml --set mesh=coarse`."
)

IDENTIFIABILITY_HELP = (
    "Do the data determine the parameters, and to what?\n\n"
    "Answers at the optimum of a stage, or with --a-priori before any data, on the planned test of the section 'simulate'. Gives "
    "correlations, the spectrum of the Hessian, the ratios of parameters that stay constant where the data leave a direction open, and "
    "what would have to be fixed. Intervals come by Laplace, block bootstrap, profile and Markov chain. --compare ranks programmes: own, "
    "monotonic, load-unload, load-unload-cool, stepped-rates, cycles. Exit code 5 where the parameters are not determined."
)
IDENTIFIABILITY_EXAMPLES = "\n".join(
    (
        "[bold]Examples:[/]",
        "  thermofit identifiability study.yaml --a-priori --stage thermal",
        "  thermofit identifiability study.yaml --compare monotonic load-unload-cool",
        "  thermofit identifiability study.yaml --stage plastic --bootstrap 1000 --profile",
    )
)
