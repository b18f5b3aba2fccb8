"""Which of many are taken."""
