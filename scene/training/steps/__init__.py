"""How a step is taken that must not be taken if it is not finite: judged at once on the CPU, judged late on a GPU."""
