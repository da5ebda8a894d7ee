"""gapmes.service.viewpoints: cameras for pictures: single views, camera paths and framings."""
