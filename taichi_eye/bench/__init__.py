"""Speed: `taichi-eye bench` measures it part by part, each figure beside what is asked of it."""
