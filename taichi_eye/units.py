"""Conversion factors: a value in the named unit times the factor is the value in SI."""

UM = 1e-6  # micrometre -> m
MM = 1e-3  # millimetre -> m
MM2 = 1e-6  # square millimetre -> m^2
MM3 = 1e-9  # cubic millimetre -> m^3
MS = 1e-3  # millisecond -> s
KPA = 1e3  # kilopascal -> Pa
MPA = 1e6  # megapascal -> Pa
MMHG = 133.322387415  # conventional millimetre of mercury -> Pa (13595.1 kg/m^3 x 9.80665 m/s^2 x 1 mm)
MPA_S = 1e-3  # millipascal second -> Pa s
UJ = 1e-6  # microjoule -> J
