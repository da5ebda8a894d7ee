"""gapmes.service.viewpoints: cameras for pictures: single views, paths through the inputs, framings."""
