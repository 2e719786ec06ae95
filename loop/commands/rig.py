"""The commands `luxloop rig ...`: a rig of real light, and one that is simulated."""

from cyclopts import App

from loop.commands.rig_calibration import board, calibrate, digitise, fit

rig_app = App(name="rig", help="A rig: a real lamp and a real camera in the loop, or a process that stands for both.")
for command in (board, calibrate, digitise, fit):
    rig_app.command(command)
