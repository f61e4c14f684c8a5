"""How to cite: BibTeX of this software, at its version, and of the paper whose model it solves."""

import taichi_eye


def bibtex() -> str:
    """Both entries."""
    return f"""@software{{taichi_eye,
  author  = {{{{The taichi_eye authors}}}},
  title   = {{taichi_eye: mesh-free simulation and film of the ophthalmic air-puff test}},
  version = {{{taichi_eye.__version__}}},
  year    = {{2026}},
  license = {{MIT}}
}}

@article{{montanino_angelillo_pandolfi,
  author  = {{Montanino, Andrea and Angelillo, Maurizio and Pandolfi, Anna}},
  title   = {{A mesh-free approach to cornea-aqueous humor interaction during tonometry tests}},
  journal = {{Journal for Modeling in Ophthalmology}},
  url     = {{https://www.modeling-ophthalmology.com/index.php/JMO/article/view/75}}
}}"""
