"""Training splats from photos with torch."""
