"""`python -m thermofit`: the command, where its script is not on the path."""

from thermofit.cli import main

if __name__ == "__main__":
    main()
