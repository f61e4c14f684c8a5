"""Pages that live in the browser: `play`, an eye under the hand, and `watch`, a run as it is computed.

guard      who is answered: this machine's own pages only; what may be sent, and how much of it
server     the address, and a server on it, in front of or behind the work      message    what it sends
hand       an eye whose sliders are moved: scene, run on the cavity rung, frames, parameters
thread     the one thread in which the kernel language runs
play       the page of `taichi-eye play`        watch    the page of `taichi-eye run --watch`
static/    HTML, style and scripts; nothing is loaded from anywhere else
"""
