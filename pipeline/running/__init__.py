"""Running a plan: in order, what a run trusts, and how one stage is built."""
