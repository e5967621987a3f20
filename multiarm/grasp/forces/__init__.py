"""Forces of the contacts that exert wrenches on the body, and the loads that they can carry."""
