"""A picture of a solution by ParaView: pvpython paraview_recipe.py two_bricks.pvd picture.png."""

import sys
from pathlib import Path

from paraview.simple import *

path, picture = Path(sys.argv[1]), sys.argv[2]
view = GetActiveViewOrCreate("RenderView")
solution = OpenDataFile(str(path))
view.ViewTime = solution.TimestepValues[-1]
solution.UpdatePipeline(view.ViewTime)
bounds = solution.GetDataInformation().GetBounds()
size = max(bounds[1] - bounds[0], bounds[3] - bounds[2], bounds[5] - bounds[4])


def longest(name):
    """Return the length of the longest vector of a field."""
    return solution.PointData[name].GetRange(-1)[1]


# 1. Deform bodies and contact surface alike.
deformed = WarpByVector(solution, Vectors="displacement")
deformed.ScaleFactor = 0.1 * size / longest("displacement")

# 2. Take the blocks apart: the bodies are glass, the contact surface is coloured by pressure.
bodies = Show(ExtractBlock(deformed, Selectors=["/Root/volume"]), view)
ColorBy(bodies, None)
bodies.Opacity, bodies.DiffuseColor = 0.15, [0.3, 0.4, 0.5]
contact = ExtractBlock(deformed, Selectors=["/Root/contact"])
surface = Show(contact, view)
ColorBy(surface, ("POINTS", "pressure"))
GetColorTransferFunction("pressure").ApplyPreset("Viridis (matplotlib)", True)

# 3. Show each node in the colour of its state, which a surface would blend with its neighbours'.
nodes = Show(PassArrays(contact, PointDataArrays=["state"]), view)
nodes.Representation, nodes.GaussianRadius = "Point Gaussian", 0.012 * size
ImportPresets(str(path.with_suffix("") / "state.json"))
ColorBy(nodes, ("POINTS", "state"))
GetColorTransferFunction("state").ApplyPreset("contact state", False)

# 4. Arrows of the slip where the surfaces are pressed together: states from 3 on.
pressed = Threshold(contact, Scalars=["POINTS", "state"], LowerThreshold=3, UpperThreshold=6)
arrows = Glyph(pressed, GlyphType="Arrow", GlyphMode="All Points")
arrows.OrientationArray = arrows.ScaleArray = ["POINTS", "slip"]
arrows.ScaleFactor = 0.12 * size / longest("slip")
shown = Show(arrows, view)
ColorBy(shown, None)
shown.DiffuseColor = [0.0, 0.0, 0.0]

# 5. Colour bars, camera, picture.
for source, name, place in ((surface, "pressure", "Lower"), (nodes, "state", "Upper")):
    source.SetScalarBarVisibility(view, True)
    bar = GetScalarBar(GetColorTransferFunction(name), view)
    bar.WindowLocation = f"{place} Right Corner"
    bar.TitleColor = bar.LabelColor = [0.0, 0.0, 0.0]
view.UseColorPaletteForBackground, view.Background = 0, [1.0, 1.0, 1.0]
view.OrientationAxesVisibility, view.ViewSize = 0, [1200, 700]
view.CameraPosition, view.CameraFocalPoint = [-0.5, -1.0, 0.8], [0.0, 0.0, 0.0]
view.CameraViewUp = [0.0, 0.0, 1.0]
ResetCamera(view)
SaveScreenshot(picture, view)
