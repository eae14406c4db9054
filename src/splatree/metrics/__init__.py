"""How near one picture is to another: PSNR, SSIM, LPIPS."""
