"""Ways to choose splats: by region of a picture, by place, by colour, by any attribute."""
