"""Our own small choice model, made from code and a seed only.

`collect` lets a robot explore built-in houses and stores each decision: the image, the frontiers in
it, and their true distance to every object. `features` reads the images with the trunk of the small
detector (`exporters.training.mini`), which stays fixed. `net` answers ViTL's two questions from
these features. `training` trains it, `evaluate` measures it on held-out houses, and `export` joins
trunk and net into one ONNX file with its card. The model knows only the built-in world.
"""
