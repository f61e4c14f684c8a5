"""Studies: one scene as many eyes.

What varies and how (`study`, `laws`), the eyes drawn (`designs`), what a row tells (`columns`, `eyes`, `exams`), who
computes (`crew` on one machine, `cluster` on Dask), what is kept (`shelf`), what comes of it (`matters`, `page`); the
whole of it is `sweep`.

    taichi-eye sweep STUDY.toml          taichi_eye.sweep("study.toml")
    taichi-eye analyze *.avi --table all.csv
"""
