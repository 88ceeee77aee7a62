"""Finding the splats that one would rather be without, each kind by a score and a threshold."""
