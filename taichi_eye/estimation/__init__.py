"""From the film back to the pressure: estimates of IOP and tissue from how an eye moves under the puff.

unknowns      what may be unknown, what is known of it beforehand, and the scene that values make
parameters    a row of clinical parameters: names, ranges, repeatability
reading       trace, film, run or table -> observation
observation   what was measured, how a model shows it, covariance of its noise and of the model's error
model_error   what the model gets wrong
motion        runs of the cheap models and of the full one
landmarks     what the search begins with
fit           the most likely eye, its covariance, the profile of its pressure
calibration   an instrument's puff over many eyes
bounds        what no estimate can beat
estimate      all that is reported of one eye
words, pictures, command     the report, its pictures, the command line
"""
