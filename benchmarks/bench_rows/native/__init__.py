"""What benchmarks alone want of native code, compiled when it is first called: the blend limit, and counts of pairs."""
