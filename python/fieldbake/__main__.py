"""``python -m fieldbake``: the command line."""

from .cli.application import main

if __name__ == "__main__":
    main()
