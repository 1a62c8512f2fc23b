"""Methods in processes of their own: what they are shown, and what of their answers is believed."""
