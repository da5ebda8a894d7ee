"""The revisions of the algorithm between the network's inputs and the stored scene, and of what is made of that."""

ALGORITHM_REVISION = 32
"""Part of every scene's id. Raise it by one with every change that gives other Gaussians or another scene document for
the same photographs, cameras, options and model file: decoding, fitting, depth estimates, checks that refuse or warn,
weights of the choice among depths, what is left out or fades, the way back to the world, the .ply. Stored scenes stay;
a request is then computed anew."""
DRAWING_REVISION = 3
"""Part of the tag of every picture and converted file. Raise it by one with every change that gives other bytes for the
same scene and query: the splatter, an encoder, a file format, the cameras that a view or a film means."""
