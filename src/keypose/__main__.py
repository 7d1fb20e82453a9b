"""`python -m keypose`."""

from keypose.cli import main

if __name__ == "__main__":
    main()
