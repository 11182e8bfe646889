"""Arguments that several commands take."""

from typing import Annotated

import typer

SceneArgument = Annotated[
    str, typer.Argument(help="Bundled scene, folder with scene.xml, or Mitsuba XML file.")
]
PoseOption = Annotated[
    str | None,
    typer.Option(help="Of the rig: x,y,z[,yaw[,pitch[,roll]]] in m and deg (x forward, z up)."),
]
