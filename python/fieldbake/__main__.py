"""``python -m fieldbake``: the command line."""

from .cli.commands import main

if __name__ == "__main__":
    main()
