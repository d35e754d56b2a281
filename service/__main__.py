"""``python -m service`` is the command ``bearing-twin``."""

from service.cli import main

if __name__ == "__main__":
    main()
