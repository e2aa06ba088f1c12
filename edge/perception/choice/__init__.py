"""A vision-language model that is asked which frontier to go to (ViTL IV-B)."""
