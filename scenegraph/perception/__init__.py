"""Changed voxels → changes of the graph: structure, objects, rooms, relations."""
