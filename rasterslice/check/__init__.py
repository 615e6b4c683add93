"""A second opinion on what another slicer wrote: read it, lay it over our slices, measure, judge."""
