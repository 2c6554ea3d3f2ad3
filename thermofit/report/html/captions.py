"""Four lines under every figure of a report: what is shown, what good looks like, what bad looks like, what to do then."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Caption:
    """Title of a figure and its four lines."""

    title: str
    shown: str
    good: str
    bad: str
    todo: str


CAPTIONS: dict[str, Caption] = {
    "bars": Caption(
        "How large is the error?",
        "Error of each channel over the noise of the data. The line marks 1, the noise itself; the open mark is the error before "
        "effects were added. Unseen data are blocks of time and place, or whole tests, that no fit has used. Scatter between specimens is "
        "the standard deviation of the stress between records of one rate and temperature at the same strain.",
        "Fit and unseen data both end near 1, and the floor of mesh and steps is far below.",
        "Unseen data far above the fit: too many parameters. Both far above 1: the model lacks something. Floor near the others: the mesh "
        "or the steps are too coarse to judge.",
        "Look at the candidate causes below; for a high floor run again with a finer mesh (`--set mesh=full`).",
    ),
    "maps": Caption(
        "Where and when is the model wrong?",
        "Prediction minus measurement over the noise, at every compared point and time. Flicker shows the two models in the same place. "
        "A click on the map chooses the point whose curves stand beside it.",
        "Salt and pepper without pattern, most values between -2 and 2, the same in both models.",
        "Patches, bands or gradients that stay from time to time, or grow in one phase of the test.",
        "Note where and when the pattern is, and compare with the candidate causes: one of them should live at that place and time.",
    ),
    "curves": Caption(
        "One point over the test",
        "Measured values as dots with a band of two standard errors, the models as lines, and their residuals below. Stress is "
        "force over initial area; stretch is that of the plane through the neighbouring points.",
        "The line runs inside the band in every phase; the residual jumps about zero.",
        "The line leaves the band in one phase, or lags behind; the residual drifts.",
        "Choose points inside and outside the patch of the map. A lag of all points at once speaks for the instrument, of some for the "
        "specimen.",
    ),
    "records": Caption(
        "One record over the test",
        "Measured values as dots, the models as lines, and their residuals over the noise.",
        "The line runs through the dots; the residual jumps about zero.",
        "The residual bends the same way in every record: the law lacks a term. In one record only: look at that record.",
        "Compare records that differ in rate or temperature; what differs with it names the cause.",
    ),
    "ladder": Caption(
        "Which causes were asked?",
        "By how much the error on unseen data falls with each candidate, an interval of two standard errors, and why it was not added.",
        "One cause stands apart, and nothing is left once it is in the model.",
        "Several causes with overlapping intervals: this test cannot tell them apart. Intervals that reach zero: nothing was shown.",
        "Read which test would decide; do not choose among equals by taste.",
    ),
    "smallest": Caption(
        "What could this test not have shown?",
        "The smallest amplitude of each effect that would have stood out from the noise, beside everything that was fitted. The share "
        "says how much of the effect no fitted parameter can imitate.",
        "Amplitudes far below those that would matter in your application, shares near 1.",
        "Amplitudes above what you would care about, shares near 0: the test is blind to the effect, whatever the page says.",
        "Where it matters, plan another test: `thermofit identifiability STUDY.yaml --compare`.",
    ),
    "decide": Caption(
        "Which test would decide?",
        "Effects that this test leaves undecided, and the programmes that would tell them apart.",
        "The list is empty.",
        "No programme decides: another instrument is needed, not another programme.",
        "Run the named test and give it to the study beside this one (`experiments:`).",
    ),
    "unlisted": Caption(
        "What no listed effect explains",
        "The strength over time of a term that was reconstructed from the residual, with two standard errors.",
        "There is none, or it stays within its band about zero.",
        "It is far outside its band in some phase.",
        "Look for what happened at that place and time; its effect file in the run folder can be added to the study.",
    ),
    "significance": Caption(
        "Significance map: is something missing inside the observed field?",
        "What a local balance misses over its standard error, over time and place. Force: that of the measured strain in the identified "
        "law less the load cell. Heat: that of pieces whose rims have their measured temperature. Rings mark what chance does not make.",
        "Pale everywhere: 0.3 % of the cells beyond 3, no ring.",
        "A patch: something is missing at that place and time. Nothing here, but structure in the residual maps: it comes from outside the "
        "observed field, from jaws or shoulders.",
        "For a patch look for a law, a source or an instrument at that place and time. For none look at the boundaries of the model.",
    ),
    "drift": Caption(
        "Which parameter wants to change with what?",
        "Fitted parameters in blocks of time, plastic strain, rate, temperature and place, beside all others; what stands out from chance "
        "and lowers the error on unseen data.",
        "Nothing is listed.",
        "A parameter that wants to change: the law lacks that dependence, or one that looks like it.",
        "Compare with the candidate causes; a slope that none of them has is a hint at a law that is not in the catalogue.",
    ),
    "parameters": Caption(
        "What was identified?",
        "Every fitted parameter with its standard error and 95 % interval between the bounds of the study. They hold the noise of the data "
        "alone, not a wrong model, mesh or temperature of the jaws.",
        "Short intervals well inside the bounds, and values that hardly move when an effect is added.",
        "A value at its bound, an interval as wide as the bounds, or a value that moves by many standard errors.",
        "Widen the bounds, fix the parameter, or ask `thermofit identifiability STUDY.yaml` which others it depends on.",
    ),
    "camera": Caption(
        "Do camera, specimen and mesh lie on each other?",
        "A frame of the infrared camera with the outline of the unloaded specimen, landmarks, points of the image correlation, and mesh.",
        "The outline lies on the visible edge at the time of the landmarks; landmarks lie where they were picked.",
        "The outline is shifted, rolled or mirrored, or points lie beside the specimen.",
        "Pick the landmarks again (`experiment.yaml`, or `ir.landmarks` of the study) and run `calibrate-ir` before anything else.",
    ),
    "phases": Caption(
        "In which phase is the model wrong?",
        "Residual of every channel in every phase over the noise, of the verified model and of the last one of the loop.",
        "About 1 everywhere.",
        "One phase far above the others.",
        "Move the time slider of the map into that phase.",
    ),
    "correlation": Caption(
        "Which parameters imitate each other?",
        "Correlation of the parameters of each stage: 1 or -1 where the data see only a sum or a ratio of two.",
        "Most entries between -0.9 and 0.9.",
        "Entries beyond 0.99: a valley, in which neither value is worth its digits.",
        "Fix one of the two from another source, or run a test that parts them.",
    ),
    "profiles": Caption(
        "How sharp is the optimum?",
        "Rise of the objective when a parameter is held aside from its optimum and the others follow; 3.84 marks the 95 % interval.",
        "A parabola that crosses the mark on both sides.",
        "Flat on one side: the data give a bound only.",
        "Report the interval of the profile, not the standard error.",
    ),
    "methods": Caption(
        "How was it done?",
        "Text of methods with references, made from what ran; also in methods.md and methods.bib.",
        "Every stage is there.",
        "A stage is missing.",
        "Run it; the text follows.",
    ),
    "provenance": Caption(
        "Where does it come from?",
        "Every stage with its state, command, time, version, digest of the sources and of its inputs.",
        "All done, by one version, none stale.",
        "A stage is stale, doubtful or missing, or was made by other sources than the rest.",
        "Run the command beside it, or `thermofit run STUDY.yaml`, which makes anew what has changed.",
    ),
}
"""By section of the page."""
