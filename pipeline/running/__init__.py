"""Runs a plan: the runner, the checks of the artifacts it uses, and the build of one stage."""
