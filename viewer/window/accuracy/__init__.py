"""What accuracy costs in time, in the window: prices, shortcuts, a frame budget, exact beside chosen."""
