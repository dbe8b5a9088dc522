"""A hand and an object in one MuJoCo model: what trials run on and pictures show."""
