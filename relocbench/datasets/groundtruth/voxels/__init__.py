"""Space cut into voxels: sorting and thinning points by voxel, and following rays from voxel to voxel."""
