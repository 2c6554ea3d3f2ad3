"""`python -m thermofit.cli` is the command `thermofit`."""

from thermofit.cli import main

main()
