"""Other places for a batch to run than this machine's own processes: Parsl, Kubernetes, Slurm."""
