"""Registration of two point clouds, or of two folders of clouds, without a drive, images or a dataset."""
