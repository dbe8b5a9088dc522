"""Values that everything else is made of, in numpy alone: poses, objects, tasks, grasps, outcomes, protocols, files."""
