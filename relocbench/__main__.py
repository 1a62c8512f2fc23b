"""``python -m relocbench``."""

from relocbench.cli import main

if __name__ == "__main__":
    main()
