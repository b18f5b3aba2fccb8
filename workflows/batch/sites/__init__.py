"""Where the scenes of a batch run other than in processes of this machine: Parsl, Kubernetes, Slurm."""
