"""The scene graph in other programs' formats.

spark_dsg : JSON of the `spark_dsg` package (Hydra, Khronos): `DynamicSceneGraph.load`
node_link : JSON of networkx: `networkx.node_link_graph(document, edges="edges")`
graphml   : XML of graph tools (yEd, Gephi, networkx): flat attributes
csv       : a table of the objects, a line each
parquet   : the same table, for data frames (needs the package pyarrow)
gltf      : boxes, outlines of rooms and, if it is given, the surface, for viewers: binary glTF
json      : our own snapshot

`read_graph` reads all but tables and glTF. `read_taxonomy` reads trees of classes: OWL and RDFS as RDF/XML or Turtle,
indented text, and tables of `child,parent`.
"""

from scenegraph.interop.export import FORMATS, Format, export_graph, render_graph
from scenegraph.interop.gltf import gltf_bytes
from scenegraph.interop.graphml import graphml_text, read_graphml
from scenegraph.interop.node_link import from_networkx, node_link_document, read_node_link
from scenegraph.interop.reading import read_graph
from scenegraph.interop.spark_dsg import spark_dsg_document
from scenegraph.interop.spark_dsg_reading import read_spark_dsg
from scenegraph.interop.table import object_rows, objects_csv, objects_parquet
from scenegraph.interop.taxonomy import Taxonomy, read_taxonomy

__all__ = [
    "FORMATS",
    "Format",
    "Taxonomy",
    "export_graph",
    "from_networkx",
    "gltf_bytes",
    "graphml_text",
    "node_link_document",
    "object_rows",
    "objects_csv",
    "objects_parquet",
    "read_graph",
    "read_graphml",
    "read_node_link",
    "read_spark_dsg",
    "read_taxonomy",
    "render_graph",
    "spark_dsg_document",
]
