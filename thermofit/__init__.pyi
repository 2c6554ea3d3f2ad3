from thermofit.library import Field as Field
from thermofit.library import Matrix as Matrix
from thermofit.library import Result as Result
from thermofit.library import demo_study as demo_study
from thermofit.library import load_study as load_study
from thermofit.library import open_record as open_record
from thermofit.library import open_run as open_run
from thermofit.library import run as run
from thermofit.library import run_stage as run_stage

__version__: str
