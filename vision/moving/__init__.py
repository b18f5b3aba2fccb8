"""Which pixels show something that moves in the world."""
