"""`e4dgs batch`: runs many scenes, on this machine or on a cluster, and resumes where it was stopped."""
