"""`python -m noiseid_cli` is the `noiseid` command."""

from noiseid_cli.app import main

main()
