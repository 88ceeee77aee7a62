"""What accuracy costs in time, in the window: prices, shortcuts by a click, a frame budget, exact beside chosen."""
