"""`e4dgs batch`: many scenes, on this machine or on a cluster, resumed where they were left."""
