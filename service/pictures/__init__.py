"""gapmes.service.pictures: renders as picture files, films and contact sheets; PSNR and SSIM."""
